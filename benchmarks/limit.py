"""A Newton iteration and W_ep against the bare sparse solver and the memory.

The neo-Hookean beam of `static_beam` at about 1 500 and 20 000 free degrees of freedom.
An iteration is the solve, less the evaluation at its start, over the number of steps.
W_ep is that of four moduli at control points for four effectors: a response that takes
one iteration and W_ep, less an evaluation and that iteration. Beside them stand, in the
same run, PARDISO with its defaults on the same matrix, and a copy of as many bytes as
the assembly must at least move: every array of the elements read once, the entries of
the tangent written once.

The errors of full Newton steps from rest, of the smaller one, show how fast they fall.

How many iterations a calibration takes per configuration and step is counted on the
beam of Sec. V, from all starts of `calibration_beam` that converge by themselves: those
of the steps that were kept, each with a factorization of its own.
"""

from collections.abc import Callable
from functools import partial
from itertools import chain, pairwise
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._cantilever import GRAVITY, equilibrium, first_lane, solve
from benchmarks._paper import CELLS, MeasuredBeam, measured_beam
from benchmarks._parts import parts
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._timing import interleave, median_ms
from benchmarks.calibration_beam import STARTS
from benchmarks.static_beam import BEAM
from softcal_jax import Configuration, Markers, Support
from softcal_jax.calibration import (
    FROM_ANYWHERE,
    CalibrationState,
    Evaluator,
    descend,
    initial_state,
)
from softcal_jax.configurations import ConfigurationArrays, configuration_arrays
from softcal_jax.equilibrium import (
    Model,
    NewtonSettings,
    Workers,
    linearise,
    residual,
)
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    ParameterSpace,
    random_starts,
)
from softcal_jax.sensitivity import equilibrium_response


class Size(NamedTuple):
    """A mesh, how often it is timed, and what is wanted of its iteration."""

    cells: tuple[int, int, int]
    repeats: int
    newton_vs_pardiso: float


SIZES = {1500: Size((20, 4, 4), 31, 2.5), 20000: Size((60, 10, 10), 7, 1.5)}
GOALS = {
    **{
        f"n{n}_newton_vs_pardiso": Goal("at most", s.newton_vs_pardiso)
        for n, s in SIZES.items()
    },
    "sensitivity_vs_pardiso_n20000": Goal("at most", 1.5),
    "newton_order": Goal("at least", 1.8),
    "newton_per_lane_per_step": Goal("at most", 2.0),
}


ROUNDING = 1e-12
"""Relative error below which there may be nothing but rounding [-]."""

MOST_ITERATIONS = 10

POINTS = 4
"""Control points of the modulus, and effectors, along the beam."""


def run(options: Options) -> Outcome:
    """Both sizes, then the iterations of calibrations."""
    figures: dict[str, Figure] = {}
    samples: dict[str, list[float]] = {}
    rows = []
    for n, size in SIZES.items():
        options.say(f"beam of about {n} free degrees of freedom")
        values, seconds = one_size(size)
        figures |= {f"n{n}_{name}": value for name, value in values.items()}
        samples |= {f"n{n}_{name}_s": times for name, times in seconds.items()}
        rows.append([str(values["free_dof"]), *(f"{values[c]:.3g}" for c in COLUMNS)])
    name = "sensitivity_vs_pardiso"
    figures[f"{name}_n20000"] = figures.pop(f"n20000_{name}")
    options.say("errors of iterations")
    model, _, lane = _case(SIZES[1500])
    errors = newton_errors(model, lane)
    falls = [[str(i), f"{error:.1e}"] for i, error in enumerate(errors)]
    samples["newton_errors"] = errors
    figures["newton_order"] = order(errors)
    options.say("iterations of calibrations")
    counted = newton_per_lane(measured_beam(CELLS, plane="xy"))
    figures["newton_per_lane_per_step"] = float(np.mean(counted))
    figures["kept_steps"] = len(counted)
    table = Table("Against the limit, medians", ["free dof", *COLUMNS.values()], rows)
    heads = ["iterations", "largest error / largest displacement"]
    convergence = Table("Convergence of Newton's method", heads, falls)
    return Outcome(figures, samples, GOALS, [table, convergence])


COLUMNS = {
    "newton_ms": "iteration [ms]",
    "pardiso_ms": "PARDISO [ms]",
    "newton_vs_pardiso": "ratio",
    "sensitivity_ms": "W_ep [ms]",
    "sensitivity_vs_pardiso": "ratio",
    "assembly_ms": "assembly [ms]",
    "copy_ms": "its memory traffic [ms]",
    "assembly_vs_copy": "ratio",
}


def one_size(size: Size) -> tuple[dict[str, Figure], dict[str, list[float]]]:
    """One mesh: figures, and the times behind them [s]."""
    model, space, lane = _case(size)
    solution = equilibrium(model, lane)
    u, z = solution.displacement, space.start()
    response = eqx.filter_jit(
        lambda model, lane, u, z: equilibrium_response(
            model, space, NewtonSettings(), z, lane, u
        )
    )
    steps = int(response(model, lane, u, z).equilibrium.steps)
    traffic = np.empty(assembly_bytes(model) // 2, np.uint8)
    wait = jax.block_until_ready
    calls: dict[str, Callable[[], object]] = {
        "solve": lambda: wait(solve(model, lane)),
        "response": lambda: wait(response(model, lane, u, z)),
        "copy": traffic.copy,
        **parts(model, lane, u),
    }
    seconds = interleave(calls, size.repeats)
    ms = {name: median_ms(times) for name, times in seconds.items()}
    newton = (ms["solve"] - ms["evaluation"]) / int(solution.steps)
    sensitivity = ms["response"] - ms["evaluation"] - steps * newton
    return {
        "newton_vs_pardiso": newton / ms["pardiso"],
        "sensitivity_vs_pardiso": sensitivity / ms["pardiso"],
        "assembly_vs_copy": ms["assembly"] / ms["copy"],
        "newton_ms": newton,
        "sensitivity_ms": sensitivity,
        "pardiso_ms": ms["pardiso"],
        "assembly_ms": ms["assembly"],
        "copy_ms": ms["copy"],
        "evaluation_ms": ms["evaluation"],
        "free_dof": int(np.sum(~np.asarray(lane.fixed))),
        "steps": int(solution.steps),
    }, seconds


def _case(size: Size) -> tuple[Model, ParameterSpace, ConfigurationArrays]:
    """The beam under its own weight, with control points and markers along it."""
    length, width, height = BEAM.size
    along = np.linspace(0.0, length, POINTS)
    at = np.stack([along, np.full(POINTS, width / 2), np.full(POINTS, height / 2)], 1)
    points = ControlPoints(at)
    moduli = ControlPointParameters("E", points, start=BEAM.E, lower=1e4, upper=1e6)
    space = ParameterSpace([moduli])
    names = [f"marker {i}" for i in range(POINTS)]
    weight = Configuration(
        "weight", [Support("x_min")], (0.0, 0.0, -GRAVITY), markers=Markers(names, at)
    )
    model = BEAM.model(size.cells)
    model = space.model_at(model, space.start())
    return model, space, first_lane(configuration_arrays(model.mesh, [weight]))


def assembly_bytes(model: Model) -> int:
    """What the assembly of a tangent must move at least.

    Args:
        model: The body.

    Returns:
        Bytes of the arrays of its elements, of the displacements and of the entries.
    """
    elements = (model.nodes, model.shape_gradients, model.weights, model.destination)
    read = sum(np.asarray(array).nbytes for array in elements)
    return read + 8 * (model.n_dof + model.pattern.nnz)


def newton_errors(model: Model, lane: ConfigurationArrays) -> list[float]:
    """Errors of the displacement from rest on, after each full Newton step [-].

    Args:
        model: The body.
        lane: One configuration.

    Returns:
        Against the last of `MOST_ITERATIONS`, over the largest displacement, down to
        rounding.

    Raises:
        RuntimeError: If the solver's equilibrium is another one.
    """

    @eqx.filter_jit
    def step(model, lane, u):
        system = linearise(model, lane, u)
        force = system.free(-residual(model, lane, u))[None]
        return system.scatter(system.solve(force, jnp.zeros((1, 0))).x)[0]

    states = [jnp.zeros((model.n_points, 3))]
    for _ in range(MOST_ITERATIONS):
        states.append(states[-1] + step(model, lane, states[-1]))
    size = lambda u: float(jnp.max(jnp.abs(u)))
    off = size(solve(model, lane).displacement - states[-1]) / size(states[-1])
    if not off < NewtonSettings().rtol:
        raise RuntimeError(f"full Newton steps end {off:g} off the equilibrium.")
    errors = [size(u - states[-1]) / size(states[-1]) for u in states]
    return errors[: 1 + next(i for i, e in enumerate(errors) if e <= ROUNDING)]


def order(errors: list[float]) -> float:
    """Order of convergence of the last three above rounding; 2 is quadratic [-]."""
    before, now, after = np.log([e for e in errors if e > ROUNDING][-3:])
    return float((after - now) / (now - before))


def newton_per_lane(measured: MeasuredBeam) -> list[float]:
    """Newton iterations per configuration, of each kept step of all calibrations."""
    settings = FROM_ANYWHERE

    def counted(evaluate: Evaluator, start) -> list[float]:
        states = [initial_state(settings, evaluate.from_rest(start))]
        end = descend(evaluate, settings, states[0], states.append)
        return _iterations(states) if end.converged else []

    starts = random_starts(measured.space, STARTS)
    n_c = len(measured.problem.configurations.gravity)
    with Workers(measured.problem.model, n_c) as workers:
        evaluate = Evaluator(measured.problem, workers)
        runs = [partial(counted, evaluate, start) for start in starts]
        return list(chain.from_iterable(workers.side_by_side(runs)))


def _iterations(states: list[CalibrationState]) -> list[float]:
    """Of the evaluations after the first, each once."""
    return [
        float(jnp.mean(new.evaluation.equilibrium.steps))
        for old, new in pairwise(states)
        if bool(jnp.any(new.z != old.z))
    ]
