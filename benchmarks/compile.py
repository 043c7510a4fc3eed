"""Cold start and second start: imports, `softcal demo`, and the paper's beam.

Every run is a process of its own. A cold one has a new home for caches; a warm one has
that of the run before, with the compiled programs and fonts that it left there. The
import is timed inside the process, after one that is not counted, so the files come
from memory. The parts of the demo are those that its `result.json` reports. The beam is
that of Sec. V, 525 nodes, four poses: from the start of its process to its first
result, the equilibria of the poses, and to the end of its calibration.
"""

import json
import re
import statistics
import sys
import tempfile
import time
from pathlib import Path

from benchmarks._paper import CELLS, Cells
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._timing import run_process

IMPORTS, STARTS = 7, 3
GOALS = {
    "demo_cold_s": Goal("at most", 60.0),
    "recompilations_after_first_step": Goal("at most", 0),
    "beam_programs_not_kept": Goal("at most", 0),
}

_TIMED_IMPORT = (
    "import time; begin = time.perf_counter(); import {}; "
    "print(time.perf_counter() - begin)"
)

COUNTS = ("recompilations_after_first_step", "beam_programs", "beam_programs_not_kept")
"""What is counted, not timed: of all runs the worst."""


def run(options: Options) -> Outcome:
    """Imports, then starts of demo and beam, cold and warm in turn."""
    samples: dict[str, list[float]] = {}
    options.say("imports")
    # JAX comes with the package; what it takes alone is the part that is not ours.
    for module in ("softcal_jax", "jax"):
        times = [_import_seconds(module) for _ in range(IMPORTS + 1)]
        samples["import_s" if module == "softcal_jax" else "import_jax_s"] = times[1:]
    for i in range(STARTS):
        options.say(f"softcal demo and the beam, {i + 1} of {STARTS}")
        for name, value in {**demo_starts(), **beam_starts(CELLS)}.items():
            samples.setdefault(name, []).append(value)
    figures: dict[str, Figure] = {
        name: int(max(values)) if name in COUNTS else statistics.median(values)
        for name, values in samples.items()
    }
    seconds = {name: times for name, times in samples.items() if name not in COUNTS}
    return Outcome(figures, seconds, GOALS, [_table(figures)])


def _table(figures: dict[str, Figure]) -> Table:
    """Cold beside warm."""
    rows = [
        [
            name.replace("_cold_", "_"),
            f"{value:.2f}",
            f"{figures[name.replace('_cold_', '_warm_')]:.2f}",
        ]
        for name, value in figures.items()
        if "_cold_" in name
    ]
    return Table("Starts, medians", ["until", "cold [s]", "warm [s]"], rows)


def _import_seconds(module: str) -> float:
    command = [sys.executable, "-c", _TIMED_IMPORT.format(module)]
    with tempfile.TemporaryDirectory() as home:
        return float(run_process(command, _at_home(home)))


def demo_starts() -> dict[str, float]:
    """Wall times of a demo, cold and then warm, and its own account of them [s]."""
    program = Path(sys.executable).with_name("softcal")
    if not program.exists():
        raise FileNotFoundError(
            f"{program} does not exist: install the package into this environment."
        )
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as home:
        for start in ("cold", "warm"):
            results = Path(home) / start
            begin = time.perf_counter()
            run_process([str(program), "demo", "-o", str(results)], _at_home(home))
            found[f"demo_{start}_s"] = time.perf_counter() - begin
            told = json.loads((results / "result.json").read_text(encoding="utf-8"))
            for part, seconds in told["timing_s"].items():
                name = re.sub(r"[^a-z0-9]+", "_", part.lower())
                found[f"demo_{start}_{name}_s"] = seconds
    return found


def beam_starts(cells: Cells) -> dict[str, float]:
    """Times of the beam, cold and then warm [s], and what was compiled.

    Args:
        cells: Cells along, up and across.

    Raises:
        RuntimeError: If its calibration does not converge.
    """
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as home:
        for start in ("cold", "warm"):
            command = [sys.executable, "-m", "benchmarks._first_result"]
            command += [str(time.time()), *map(str, cells)]
            told = json.loads(run_process(command, _at_home(home)))
            if not told["converged"]:
                raise RuntimeError("the calibration of the beam did not converge.")
            for part in ("first_result", "calibration", "compile"):
                found[f"beam_{start}_{part}_s"] = told[f"{part}_s"]
            again = "recompilations_after_first_step"
            found[again] = max(found.get(again, 0), told[again])
    found["beam_programs"] = told["programs"]
    found["beam_programs_not_kept"] = told["programs"] - told["from_disk"]
    return found


def _at_home(home: str) -> dict[str, str]:
    """Environment with nothing kept from earlier runs but what is in a folder."""
    return {
        "XDG_CACHE_HOME": home,
        "MPLCONFIGDIR": home,  # matplotlib lists the fonts once, which takes a second
        "JAX_ENABLE_COMPILATION_CACHE": "true",
        "JAX_COMPILATION_CACHE_DIR": str(Path(home) / "jax"),
    }
