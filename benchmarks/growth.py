"""How time and memory grow with the mesh, up to 100 000 nodes.

- An equilibrium: the neo-Hookean beam of `static_beam` under its own weight, in cubic
  cells, solved from rest.
- A calibration: the beam of Sec. V, four configurations and six parameters, from its
  usual start to convergence, its configurations side by side on all cores.

Each mesh has a process of its own, and everything is compiled before it is timed. Time,
and the peak memory beyond that of the imports, are fitted as powers of the number of
nodes by least squares of the logarithms. A mesh that needs more memory than the machine
has, or whose process fails, ends its series and is named.
"""

import json
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks._memory import peak_bytes
from benchmarks._problem import Better, Figure, Goal, Options, Outcome, Table
from benchmarks._timing import forget_starts, run_process

ACROSS = {"solve": (4, 6, 9, 13, 16, 18, 22, 27), "calibration": (4, 6, 10, 14)}
"""Cells across the beam; five times as many along it.

The elements of the calibration are quadratic: 14 cells have 119 000 nodes.
"""

SECONDS = 5.0
"""A mesh is solved again until this time is spent, once at least [s]."""

MOST_REPEATS = 15

GOALS = {
    "time_exponent": Goal("at most", 1.5),
    "largest_nodes": Goal("at least", 100_000),
    "peak_memory_gb": Goal("at most", 16),
    "calibration_time_exponent": Goal("at most", 1.4),
    "calibration_largest_nodes": Goal("at least", 100_000),
    "calibration_peak_gb": Goal("at most", 16),
}

COLUMNS = {
    "nodes": "nodes",
    "seconds": "time [s]",
    "steps": "steps",
    "setup_s": "set-up [s]",
    "memory_gb": "memory [GB]",
}

Row = Mapping[str, float]


def run(options: Options) -> Outcome:
    """Measure all meshes, each in a process of its own."""
    solve, ended = _series(options, "solve")
    figures: dict[str, Figure] = {
        "time_exponent": _power(solve, "seconds"),
        "last_time_exponent": _power(solve[-2:], "seconds"),
        "memory_exponent": _power(solve, "memory_gb"),
        "largest_nodes": int(solve[-1]["nodes"]),
        "peak_memory_gb": max(row["peak_gb"] for row in solve),
        "largest_solve_s": solve[-1]["seconds"],
        "ended_by": ended,
    }
    calibration, ended = _series(options, "calibration")
    figures |= {
        "calibration_time_exponent": _power(calibration, "seconds"),
        "calibration_last_time_exponent": _power(calibration[-2:], "seconds"),
        "calibration_largest_nodes": int(calibration[-1]["nodes"]),
        "calibration_peak_gb": max(row["peak_gb"] for row in calibration),
        "largest_calibration_s": calibration[-1]["seconds"],
        "calibration_ended_by": ended,
    }
    by_kind = {"solve": solve, "calibration": calibration}
    samples = {
        f"{kind}_{name}": [row[name] for row in rows]
        for kind, rows in by_kind.items()
        for name in COLUMNS
    }
    tables = [
        Table(
            f"Growth of one {kind} with the mesh",
            list(COLUMNS.values()),
            [[f"{row[name]:.3g}" for name in COLUMNS] for row in rows],
        )
        for kind, rows in by_kind.items()
    ]
    better: dict[str, Better] = dict.fromkeys(
        (name for name in figures if "exponent" in name), "lower"
    )
    return Outcome(figures, samples, GOALS, tables, better)


def _power(rows: Sequence[Row], name: str) -> float:
    return exponent([row["nodes"] for row in rows], [row[name] for row in rows])


def _series(options: Options, kind: str) -> tuple[list[Row], str]:
    """Measure meshes as long as the machine can hold them, and say why that ended.

    Raises:
        RuntimeError: If fewer than two could be measured.
    """
    rows: list[Row] = []
    for across in ACROSS[kind]:
        options.say(f"{kind}, {across} cells across the beam")
        command = [sys.executable, "-m", "benchmarks.growth", kind, str(across)]
        try:
            rows.append(json.loads(run_process(command).splitlines()[-1]))
        except RuntimeError as error:
            if len(rows) < 2:
                raise
            last = str(error).splitlines()[-1]
            return rows, f"{across} cells across failed: {last}"
    return rows, "the largest mesh that was asked for"


def exponent(nodes: Sequence[float], cost: Sequence[float]) -> float:
    """Fit a cost by a power of the number of nodes, by logarithms."""
    return float(np.polyfit(np.log(nodes), np.log(cost), 1)[0])


class Prepared(NamedTuple):
    """What is timed on one mesh, with everything compiled.

    Attributes:
        nodes: Number of nodes.
        steps: Runs it once and returns its number of steps.
    """

    nodes: int
    steps: Callable[[], int]


def prepared_solve(across: int, solver: str | None) -> Prepared:
    """An equilibrium of the neo-Hookean beam, by the usual solver or by name."""
    from benchmarks._cantilever import equilibrium, first_lane, own_weight
    from benchmarks.static_beam import BEAM

    model = BEAM.model((5 * across, across, across), solver=solver)
    lane = first_lane(own_weight(model))
    equilibrium(model, lane)
    return Prepared(model.mesh.n_nodes, lambda: int(equilibrium(model, lane).steps))


def prepared_calibration(across: int) -> Prepared:
    """A calibration of the beam of Sec. V.

    Raises:
        RuntimeError: If a run does not end at p_target.
    """
    from benchmarks._paper import measured_beam, one_run, parameter_errors, recovered
    from softcal_jax.calibration import CalibrationSettings

    measured = measured_beam((5 * across, across, across), plane="xy")
    problem, space, target = measured.problem, measured.space, measured.target

    def steps() -> int:
        forget_starts()
        end = one_run(problem, CalibrationSettings(), space.start())
        if not recovered(parameter_errors(space, end.z, target)):
            raise RuntimeError(f"{across} cells across: p_target was not recovered.")
        return end.steps

    # A run that begins where it ends compiles what others consist of.
    one_run(problem, CalibrationSettings(), target)
    return Prepared(problem.model.mesh.n_nodes, steps)


def one_mesh(kind: str, across: int) -> dict[str, float]:
    """Measure time and memory of one mesh in this process.

    Args:
        kind: "solve" or "calibration", or a sparse solver by its name to solve with.
        across: Cells across the beam.
    """
    imported = peak_bytes()
    begin = time.perf_counter()
    if kind == "calibration":
        nodes, run_once = prepared_calibration(across)
    else:
        nodes, run_once = prepared_solve(across, None if kind == "solve" else kind)
    setup = time.perf_counter() - begin
    seconds: list[float] = []
    steps = 0
    while not seconds or (sum(seconds) < SECONDS and len(seconds) < MOST_REPEATS):
        begin = time.perf_counter()
        steps = run_once()
        seconds.append(time.perf_counter() - begin)
    return {
        "nodes": nodes,
        "seconds": statistics.median(seconds),
        "steps": steps,
        "setup_s": setup,
        "memory_gb": (peak_bytes() - imported) / 1e9,
        "peak_gb": peak_bytes() / 1e9,
    }


if __name__ == "__main__":
    import jax

    jax.config.update("jax_enable_x64", True)
    print(json.dumps(one_mesh(sys.argv[1], int(sys.argv[2]))))
