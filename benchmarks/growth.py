"""How time and memory of an equilibrium grow with the mesh, up to 200 000 nodes.

The neo-Hookean beam of `static_beam` under its own weight, in cells that are cubes: the
whole solve from rest, compiled, and the peak memory of a process of its own for each
mesh, beyond that of its imports. Both are fitted as powers of the number of nodes by
least squares of the logarithms: with `solver="auto"`, and with the direct solver alone,
whose tip the other is held against; multigrid also where "auto" leaves it out. A mesh
that needs more memory than the machine has, or whose process fails, ends the series and
is named.
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

ACROSS = (4, 6, 9, 13, 16, 18, 22, 27, 34)
"""Cells across the beam; five times as many along it."""

ACROSS_DIRECT = ACROSS[:-1]
"""The same for the direct solver."""

ACROSS_MULTIGRID = (9, 13)
"""The same for multigrid where the direct solver is the faster one."""

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
    """All meshes, each in a process of its own."""
    auto, ended = _series(options, "auto", ACROSS)
    direct, direct_ended = _series(options, "direct", ACROSS_DIRECT)
    multigrid, multigrid_ended = _series(options, "multigrid", ACROSS_MULTIGRID, 0)
    figures = _figures("", auto, ended) | _figures("direct_", direct, direct_ended)
    theirs = {row["nodes"]: row for row in direct}
    shared, left_out = (
        [row for row in found if row["nodes"] in theirs] for found in (auto, multigrid)
    )
    against = lambda row, name: row[name] / theirs[row["nodes"]][name]
    figures["over_direct_at_its_largest"] = against(shared[-1], "solve_s")
    apart = [abs(against(row, "tip_m") - 1.0) for row in (*shared, *left_out)]
    figures["tip_difference"] = max(apart)
    if left_out:
        figures["multigrid_over_direct_left_out"] = against(left_out[-1], "solve_s")
    figures["multigrid_ended_by"] = multigrid_ended
    series = {"": auto, "direct_": direct, "multigrid_": multigrid}
    samples = {
        f"{prefix}series_{name}": [row[name] for row in found]
        for prefix, found in series.items()
        for name in COLUMNS
    }
    better: dict[str, Better] = dict.fromkeys(
        (name for name in figures if "exponent" in name or "over_direct" in name),
        "lower",
    )
    titles = ("auto", "direct solver", "multigrid where auto leaves it out")
    tables = [
        Table(
            f"Growth with the mesh, {title}",
            list(COLUMNS.values()),
            [[f"{row[name]:.3g}" for name in COLUMNS] for row in found],
        )
        for title, found in zip(titles, series.values(), strict=True)
    ]
    return Outcome(figures, samples, GOALS, tables, better)


def _series(
    options: Options, solver: str, meshes: Sequence[int], least: int = 2
) -> tuple[list[dict[str, float]], str]:
    """What the meshes took, as far as they could be solved, and why that ended.

    Raises:
        RuntimeError: If fewer than the least number could be solved.
    """
    found: list[dict[str, float]] = []
    for across in meshes:
        options.say(f"{solver}: {across} cells across the beam")
        command = [sys.executable, "-m", "benchmarks.growth", solver, str(across)]
        try:
            found.append(json.loads(run_process(command).splitlines()[-1]))
        except RuntimeError as error:
            if len(found) < least:
                raise
            last = str(error).splitlines()[-1]
            return found, f"{across} cells across failed: {last}"
    return found, "the largest mesh that was asked for"


def _figures(prefix: str, found, ended: str) -> dict[str, Figure]:
    """Powers and extremes of a series."""
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
    return {prefix + name: value for name, value in figures.items()}


def exponent(nodes: Sequence[float], cost: Sequence[float]) -> float:
    """Power of the number of nodes that fits a cost, by logarithms."""
    return float(np.polyfit(np.log(nodes), np.log(cost), 1)[0])


def one_mesh(solver: str, across: int) -> dict[str, float]:
    """Time and memory of one mesh with one solver, in this process."""
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
        "tip_m": float(first.displacement[:, 2].min()),
        "setup_s": setup,
        "memory_gb": (peak_bytes() - imported) / 1e9,
        "peak_gb": peak_bytes() / 1e9,
    }


if __name__ == "__main__":
    import jax

    jax.config.update("jax_enable_x64", True)
    print(json.dumps(one_mesh(sys.argv[1], int(sys.argv[2]))))
