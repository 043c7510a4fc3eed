"""Memory of one model, measured in a process of its own: `_memory NX NY NZ`."""

import json
import resource
import sys
from pathlib import Path

import jax
import numpy as np


def peak_bytes() -> int:
    """Largest resident size of this process so far.

    Linux keeps it per program; `getrusage` there still counts the parent before exec.
    """
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def array_bytes(tree: object) -> int:
    """Bytes of all arrays of a pytree."""
    leaves = [x for x in jax.tree.leaves(tree) if isinstance(x, np.ndarray | jax.Array)]
    return sum(leaf.nbytes for leaf in leaves)


def main() -> None:
    """Build, solve, and print what it took as JSON."""
    jax.config.update("jax_enable_x64", True)
    from benchmarks._cantilever import equilibrium, first_lane, own_weight
    from benchmarks.static_beam import BEAM

    imported = peak_bytes()
    nx, ny, nz = map(int, sys.argv[1:])
    model = BEAM.model((nx, ny, nz))
    built = peak_bytes()
    equilibrium(model, first_lane(own_weight(model)))
    print(
        json.dumps(
            {
                "n_tets": model.n_tets,
                "model_bytes": array_bytes(model),
                "peak_after_import": imported,
                "peak_after_build": built,
                "peak_after_solve": peak_bytes(),
            }
        )
    )


if __name__ == "__main__":
    main()
