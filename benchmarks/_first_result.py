"""The beam of Sec. V in a process of its own: `_first_result BEGIN NX NY NZ`.

Prints as JSON when its first result is there and when its calibration ends, counted
from BEGIN [s since 1970], and what was compiled on the way.
"""

import json
import sys
import time
from collections import Counter

import jax

from benchmarks._compilations import Compilations
from softcal_jax._compilation_cache import use_compilation_cache


def main() -> None:
    """Simulate the measurements, calibrate against them, and print."""
    begin = float(sys.argv[1])
    nx, ny, nz = map(int, sys.argv[2:])
    jax.config.update("jax_enable_x64", True)
    use_compilation_cache()
    events: Counter[str] = Counter()
    jax.monitoring.register_event_listener(lambda event, **_: events.update([event]))

    from benchmarks._paper import STD
    from softcal_jax.calibration import Event, HistoryEntry, calibrate
    from softcal_jax.robots import anisotropic_beam, synthetic_measurements

    with Compilations() as seen:
        beam = anisotropic_beam(cells=(nx, ny, nz), plane="xy", std=STD)
        poses = synthetic_measurements(
            beam.model, beam.space, beam.configurations, beam.target
        )
        simulated = time.time() - begin
        compiled: list[int] = []

        def note(event: Event) -> None:
            if isinstance(event, HistoryEntry):
                compiled.append(len(seen.programs))

        result = calibrate(
            beam.model, beam.space, poses, starts=1, intervals=None, watch=note
        )
    cache = "/jax/compilation_cache/"
    print(
        json.dumps(
            {
                "first_result_s": simulated,
                "calibration_s": time.time() - begin,
                "compile_s": sum(seen.seconds),
                "converged": result.converged,
                "recompilations_after_first_step": compiled[-1] - compiled[1],
                "programs": len(seen.programs),
                "from_disk": events[cache + "cache_hits"],
            }
        )
    )


if __name__ == "__main__":
    main()
