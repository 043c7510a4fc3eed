"""How time and memory of an equilibrium grow with the mesh, up to 100 000 nodes.

The neo-Hookean beam of `static_beam` under its own weight, in cubic cells: the whole
solve from rest, compiled, and the peak memory of a process of its own for each mesh,
beyond that of its imports. Both are fitted as powers of the number of nodes by least
squares of the logarithms. A mesh that needs more memory than the machine has, or whose
process fails, ends the series and is named.
"""

import json
import statistics
import sys
import time
from collections.abc import Sequence

import numpy as np

from benchmarks._memory import peak_bytes
from benchmarks._problem import Better, Figure, Goal, Options, Outcome, Table
from benchmarks._timing import run_process

ACROSS = (4, 6, 9, 13, 16, 18, 22, 27)
"""Cells across the beam; five times as many along it."""

SECONDS = 5.0
"""A mesh is solved again until this time is spent, once at least [s]."""

MOST_REPEATS = 15

GOALS = {
    "time_exponent": Goal("at most", 1.5),
    "largest_nodes": Goal("at least", 100_000),
    "peak_memory_gb": Goal("at most", 16),
}

COLUMNS = {
    "nodes": "nodes",
    "solve_s": "solve [s]",
    "steps": "steps",
    "setup_s": "set-up [s]",
    "memory_gb": "memory [GB]",
}


def run(options: Options) -> Outcome:
    """Solve all meshes, each in a process of its own."""
    found, ended = _series(options)
    column = lambda name: [row[name] for row in found]
    nodes = column("nodes")
    power = lambda name, since=0: exponent(nodes[since:], column(name)[since:])
    figures: dict[str, Figure] = {
        "time_exponent": power("solve_s"),
        "last_time_exponent": power("solve_s", -2),
        "memory_exponent": power("memory_gb"),
        "largest_nodes": int(nodes[-1]),
        "peak_memory_gb": max(column("peak_gb")),
        "largest_solve_s": found[-1]["solve_s"],
        "ended_by": ended,
    }
    samples = {f"series_{name}": column(name) for name in COLUMNS}
    better: dict[str, Better] = dict.fromkeys(
        (name for name in figures if "exponent" in name), "lower"
    )
    rows = [[f"{row[name]:.3g}" for name in COLUMNS] for row in found]
    table = Table("Growth with the mesh", list(COLUMNS.values()), rows)
    return Outcome(figures, samples, GOALS, [table], better)


def _series(options: Options) -> tuple[list[dict[str, float]], str]:
    """Measure meshes as long as they can be solved, and say why that ended.

    Raises:
        RuntimeError: If fewer than two could be solved.
    """
    found: list[dict[str, float]] = []
    for across in ACROSS:
        options.say(f"{across} cells across the beam")
        command = [sys.executable, "-m", "benchmarks.growth", "direct", str(across)]
        try:
            found.append(json.loads(run_process(command).splitlines()[-1]))
        except RuntimeError as error:
            if len(found) < 2:
                raise
            last = str(error).splitlines()[-1]
            return found, f"{across} cells across failed: {last}"
    return found, "the largest mesh that was asked for"


def exponent(nodes: Sequence[float], cost: Sequence[float]) -> float:
    """Fit a cost by a power of the number of nodes, by logarithms."""
    return float(np.polyfit(np.log(nodes), np.log(cost), 1)[0])


def one_mesh(solver: str, across: int) -> dict[str, float]:
    """Measure time and memory of one mesh in this process."""
    from benchmarks._cantilever import equilibrium, first_lane, own_weight
    from benchmarks.static_beam import BEAM

    imported = peak_bytes()
    begin = time.perf_counter()
    name = None if solver == "direct" else solver
    model = BEAM.model((5 * across, across, across), solver=name)
    lane = first_lane(own_weight(model))
    setup = time.perf_counter() - begin
    first = equilibrium(model, lane)  # compiles
    seconds: list[float] = []
    while not seconds or (sum(seconds) < SECONDS and len(seconds) < MOST_REPEATS):
        begin = time.perf_counter()
        equilibrium(model, lane)
        seconds.append(time.perf_counter() - begin)
    return {
        "nodes": model.mesh.n_nodes,
        "solve_s": statistics.median(seconds),
        "steps": int(first.steps),
        "setup_s": setup,
        "memory_gb": (peak_bytes() - imported) / 1e9,
        "peak_gb": peak_bytes() / 1e9,
    }


if __name__ == "__main__":
    import jax

    jax.config.update("jax_enable_x64", True)
    print(json.dumps(one_mesh(sys.argv[1], int(sys.argv[2]))))
