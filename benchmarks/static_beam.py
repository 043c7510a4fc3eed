"""Static equilibrium of a beam of linear tets: against FElupe, and against PARDISO.

Three meshes of 525, 2 009 and 7 381 nodes, compressible neo-Hookean, own weight, both
to a residual of 1e-8. Times are after compilation and leave out the set-up of the mesh,
ours and FElupe's. One Newton iteration of ours is the solve, less the evaluation at the
start, over the number of steps; beside it stands the bare PARDISO factorization and
solution of the same matrix, in the same run.
"""

import json
import sys
import time
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np

from benchmarks._cantilever import (
    Beam,
    equilibrium,
    first_lane,
    nearest,
    own_weight,
    solve,
    tip,
)
from benchmarks._felupe import FelupeBeam, Solver, linear_solvers, tuned_solvers
from benchmarks._parts import parts
from benchmarks._problem import Better, Figure, Goal, Options, Outcome, Table
from benchmarks._timing import interleave, median_ms, ratio, run_process
from softcal_jax.equilibrium import Model

BEAM = Beam((0.1, 0.02, 0.02), E=3e5, nu=0.4)
TOL = 1e-8


class Size(NamedTuple):
    """A mesh, how often it is timed, and what is wanted of it."""

    cells: tuple[int, int, int]
    repeats: int
    vs_felupe: float
    newton_vs_pardiso: float


SIZES = {
    525: Size((20, 4, 4), 31, 3.0, 3.0),
    2009: Size((40, 6, 6), 15, 3.0, 2.5),
    7381: Size((60, 10, 10), 7, 1.5, 1.5),
}
GOALS = {
    **{f"n{n}_vs_felupe": Goal("at least", s.vs_felupe) for n, s in SIZES.items()},
    **{
        f"n{n}_newton_vs_pardiso": Goal("at most", s.newton_vs_pardiso)
        for n, s in SIZES.items()
    },
    "batch4_over_4_singles_n525": Goal("at most", 1.0),
}


class Peer(NamedTuple):
    """FElupe with its fastest linear solver on this mesh."""

    name: str
    solve: Callable[[], object]
    setup_s: float
    iterations: int
    tip: np.ndarray


def run(options: Options) -> Outcome:
    """All sizes, then the batch and the memory."""
    figures: dict[str, Figure] = {}
    samples: dict[str, list[float]] = {}
    rows = []
    for n, size in SIZES.items():
        options.say(f"beam of {n} nodes")
        values, seconds = _one_size(n, size)
        figures |= values
        samples |= {f"n{n}_{name}_s": times for name, times in seconds.items()}
        rows.append(_row(n, values))
    options.say("memory, in processes of their own")
    figures |= _memory()
    columns = ["nodes", "ours ms", "steps", "FElupe ms", "steps", "FElupe/ours"]
    columns += ["tuned FElupe/ours"]
    columns += ["iteration ms", "PARDISO ms", "iteration/PARDISO"]
    table = Table("Static beam, medians", columns, rows)
    peers: dict[str, Better] = {
        name: "either"
        for name in figures
        if name.endswith("_ms") and ("felupe" in name or "pardiso" in name)
    }
    return Outcome(figures, samples, GOALS, [table], peers)


def _row(n: int, values: dict[str, Figure]) -> list[str]:
    names = ["ours_ms", "steps", "felupe_ms", "felupe_steps", "vs_felupe"]
    names += ["vs_felupe_tuned"]
    names += ["newton_ms", "pardiso_ms", "newton_vs_pardiso"]
    return [str(n), *(f"{values[f'n{n}_{name}']:.4g}" for name in names)]


def _one_size(n: int, size: Size) -> tuple[dict[str, Figure], dict[str, list[float]]]:
    begin = time.perf_counter()
    model = BEAM.model(size.cells)
    setup = time.perf_counter() - begin
    lane = first_lane(own_weight(model))
    begin = time.perf_counter()
    solution = equilibrium(model, lane)
    first = time.perf_counter() - begin
    peer = _fastest_peer(model, linear_solvers())
    tuned = _fastest_peer(model, tuned_solvers())
    at_tip = nearest(model.mesh.points, tip(BEAM.size))
    difference = _agreement(solution.displacement[at_tip], peer.tip)

    functions: dict[str, Callable[[], object]] = {
        "ours": lambda: jax.block_until_ready(solve(model, lane)),
        "felupe": peer.solve,
        "felupe_tuned": tuned.solve,
        **parts(model, lane, solution.displacement),
    }
    if n == min(SIZES):
        functions["batch4"] = _batch(model, 4)
    seconds = interleave(functions, size.repeats)
    ours, evaluation = median_ms(seconds["ours"]), median_ms(seconds["evaluation"])
    newton = (ours - evaluation) / int(solution.steps)
    pardiso = median_ms(seconds["pardiso"])
    figures: dict[str, Figure] = {
        "vs_felupe": ratio(seconds["felupe"], seconds["ours"]),
        "vs_felupe_tuned": ratio(seconds["felupe_tuned"], seconds["ours"]),
        "newton_vs_pardiso": newton / pardiso,
        "ours_ms": ours,
        "felupe_ms": median_ms(seconds["felupe"]),
        "felupe_solver": peer.name,
        "felupe_tuned_ms": median_ms(seconds["felupe_tuned"]),
        "felupe_tuned_solver": tuned.name,
        "newton_ms": newton,
        "pardiso_ms": pardiso,
        "assembly_ms": median_ms(seconds["assembly"]),
        "evaluation_ms": evaluation,
        "steps": int(solution.steps),
        "felupe_steps": peer.iterations,
        "tip_difference": difference,
        "first_solve_s": first,
        "setup_ms": 1e3 * setup,
        "felupe_setup_ms": 1e3 * peer.setup_s,
    }
    figures = {f"n{n}_{name}": value for name, value in figures.items()}
    if "batch4" in seconds:
        share = ratio(seconds["batch4"], seconds["ours"]) / 4.0
        figures[f"batch4_over_4_singles_n{n}"] = share
    return figures, seconds


def _agreement(ours: jax.Array, peer: np.ndarray) -> float:
    """Relative difference of the tip's displacement; both must solve the same problem.

    Raises:
        RuntimeError: If it exceeds 1e-6, and the times would compare nothing.
    """
    difference = float(np.linalg.norm(ours - peer) / np.linalg.norm(peer))
    if difference > 1e-6:
        raise RuntimeError(
            f"the tip moves by {ours} here and by {peer} in FElupe, relative "
            f"difference {difference:.1e}: the two do not solve the same problem."
        )
    return difference


def _fastest_peer(model: Model, solvers: dict[str, Solver]) -> Peer:
    """Try solvers for FElupe, with and without threads, and keep the fastest."""
    mesh = model.mesh
    best: tuple[float, Peer] | None = None
    at_tip = nearest(mesh.points, tip(BEAM.size))
    for parallel in (False, True):
        begin = time.perf_counter()
        built = FelupeBeam(BEAM, mesh.points, mesh.tets, parallel=parallel)
        setup = time.perf_counter() - begin
        for name, solver in solvers.items():
            call = _felupe_call(built, solver)
            begin = time.perf_counter()
            solution = call()
            once = time.perf_counter() - begin
            if best is not None and once > 2.0 * best[0]:
                continue  # hopeless, and a second trial of SuperLU takes seconds
            trial = min(once, *interleave({name: call}, 1)[name])
            if best is None or trial < best[0]:
                label = f"{name}, {'threads' if parallel else 'no threads'}"
                where = solution.displacement[at_tip]
                best = trial, Peer(label, call, setup, solution.iterations, where)
    assert best is not None
    return best[1]


def _felupe_call(built: FelupeBeam, solver: Solver):
    return lambda: built.solve(solver, TOL)


def _batch(model: Model, lanes: int) -> Callable[[], object]:
    """Equilibria of several lanes under the same load in one call."""
    configurations = own_weight(model, lanes)
    batched = eqx.filter_jit(
        lambda model, lanes: jax.vmap(lambda lane: solve(model, lane))(lanes)
    )
    return lambda: jax.block_until_ready(batched(model, configurations))


def _memory() -> dict[str, Figure]:
    """Bytes per tet, and how the peak of a whole process grows with the mesh."""
    figures: dict[str, Figure] = {}
    previous = None
    for n, size in SIZES.items():
        command = [sys.executable, "-m", "benchmarks._memory", *map(str, size.cells)]
        memory = json.loads(run_process(command))
        figures[f"n{n}_model_bytes_per_tet"] = memory["model_bytes"] / memory["n_tets"]
        figures[f"n{n}_peak_mb"] = memory["peak_after_solve"] / 1e6
        if previous is not None:
            m, before = previous
            growth = memory["peak_after_solve"] - before["peak_after_solve"]
            figures[f"peak_bytes_per_tet_n{m}_to_n{n}"] = growth / (
                memory["n_tets"] - before["n_tets"]
            )
        previous = n, memory
    return figures
