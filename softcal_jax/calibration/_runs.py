"""The outer loop as one traced program, from many starts in one batch."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, Int
from softcal_jax.calibration._problem import CalibrationProblem, evaluate, first_guess
from softcal_jax.calibration._proposal import propose
from softcal_jax.calibration._state import (
    CalibrationSettings,
    CalibrationState,
    initial_state,
)
from softcal_jax.calibration._step import decide
from softcal_jax.equilibrium import lane_by_lane
from softcal_jax.fields import ParameterSpace

NOTHING_LEFT = 1e-6
"""Mean squared error, in noise units, below which no other optimum is looked for."""


class Run(eqx.Module):
    """End of the outer loop; from a batch of starts, arrays with a leading axis.

    Attributes:
        z: Scaled parameters [-].
        cost: Half the sum of squared errors in noise units; infinite if the start has
            no equilibrium [-].
        steps: QP steps, those of mirrored runs included.
        converged: Whether lambda_p vanished.
        errors: Root of twice the cost after each step of the first run; nan after its
            end [-].
    """

    z: Float[Array, "*starts n_p"]
    cost: Float[Array, "*starts"]
    steps: Int[Array, "*starts"]
    converged: Bool[Array, "*starts"]
    errors: Float[Array, "*starts n_steps"]


def run_starts(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    starts: Float[Array, "n_starts n_p"],
    *,
    mirror: bool = True,
) -> Run:
    """Run the outer loop from every start: one traceable program, one `vmap`.

    Args:
        problem: The calibration.
        settings: Settings of the outer loop.
        starts: Scaled parameters to start from [-].
        mirror: Whether a run that ends with an error goes on from mirror images: that
            of its end with all material axes reflected (theta to -theta), that of its
            start, and those of its start with one axis reflected after the other. A
            body that is loaded in or across its print plane hardly tells an axis from
            its reflection, and each has an optimum. At the last from the axes of its
            end, with all other parameters as the space starts them. The best is kept,
            and finished if the step limit ended it before it converged.

    Returns:
        How each of them ended.
    """
    images = images_of(problem.space, mirror)

    @lane_by_lane
    def lane(problem, images, start):
        def try_image(best, image):
            z = origin(best, image, start)
            best = jax.lax.cond(
                wanted(problem, best, image),
                lambda: better(best, minimise(problem, settings, z)),
                lambda: best,
            )
            return best, None

        return jax.lax.scan(try_image, nothing_yet(settings, start), images)[0]

    return jax.vmap(lambda start: lane(problem, images, start))(starts)


def nothing_yet(settings: CalibrationSettings, start: Float[Array, " n_p"]) -> Run:
    """A run before its first step."""
    return Run(
        start,
        jnp.full((), jnp.inf, start.dtype),
        jnp.zeros((), jnp.int32),
        jnp.zeros((), bool),
        jnp.full((settings.max_steps + 1,), jnp.nan, start.dtype),
    )


class Image(NamedTuple):
    """A further run, from `signs` times the best end so far, or the start, and `plus`.

    `elsewhere` tells it from one that goes on where a run was ended by its limit.
    """

    signs: Float[Array, " n_p"]
    plus: Float[Array, " n_p"]
    elsewhere: Bool[Array, ""]
    of_start: Bool[Array, ""]


def images_of(space: ParameterSpace, mirror: bool) -> Image:
    """What is tried: the start, images of the end, images of the start; the finish.

    Of the end only that with all axes reflected: where that leads nowhere, the run has
    lost its way, and the start is the better origin. At the last its axes with all else
    as the space starts it: there it may be the moduli that went astray.
    """
    angles = [] if space.chart is None else list(space.chart.angle)
    turns = np.isin(np.arange(len(space.names)), angles)

    def image(*, reflected=(), of_start=False) -> Image:
        signs = np.ones(len(turns))
        signs[list(reflected)] = -1.0
        plus = jnp.zeros(len(turns))
        flags = jnp.asarray(len(reflected) > 0), jnp.asarray(of_start)
        return Image(jnp.asarray(signs), plus, *flags)

    images = [image()]
    if mirror and angles:
        each = [[i] for i in angles] if len(angles) > 1 else []
        as_given, no = jnp.where(turns, 0.0, space.start()), jnp.zeros((), bool)
        images += [
            image(reflected=angles),
            *(image(reflected=group, of_start=True) for group in (angles, *each)),
            Image(jnp.asarray(turns, float), as_given, jnp.ones((), bool), no),
            image(),
            image(),
        ]
    return jax.tree.map(lambda *rows: jnp.stack(rows), *images)


def origin(best: Run, image: Image, start: Float[Array, " n_p"]):
    """Where the run of an image begins, as scaled parameters."""
    return image.signs * jnp.where(image.of_start, start, best.z) + image.plus


def wanted(problem: CalibrationProblem, best: Run, image: Image) -> Bool[Array, ""]:
    """Whether an image is worth a run."""
    seen = problem.configurations.effectors.inverse_std > 0.0
    measured = jnp.sum(seen, dtype=best.cost.dtype)
    nothing_left = 2.0 * best.cost <= NOTHING_LEFT * measured
    # A start without equilibrium has no end to go on from.
    lost = jnp.isinf(best.cost) & (best.steps > 0)
    unfinished = ~best.converged & ~lost
    return jnp.where(image.elsewhere, ~lost & ~nothing_left, unfinished)


def minimise(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    start: Float[Array, " n_p"],
) -> Run:
    """The outer loop from one start, to its end.

    The start is evaluated by the first pass of the loop, so that `evaluate`, most of
    the program, is in it once.

    Args:
        problem: The calibration.
        settings: Settings of the outer loop.
        start: Scaled parameters to start from [-].
    """
    z = problem.space.admissible(start)
    rest = first_guess(problem, z)
    empty = jax.tree.map(
        lambda leaf: jnp.zeros(leaf.shape, leaf.dtype),
        jax.eval_shape(evaluate, problem, z, rest),
    )
    errors = jnp.full((settings.max_steps + 1,), jnp.nan, z.dtype)

    def going(carry):
        begun, state, _ = carry
        ended = state.converged | state.stalled | ~state.evaluation.ok
        return ~begun | (~ended & (state.step < settings.max_steps))

    def step(carry):
        begun, state, errors = carry
        proposal = propose(problem, settings, state)
        choose = lambda a, b: jnp.where(begun, a, b)
        tried = jax.lax.cond(
            begun & proposal.vanishes,
            lambda: state.evaluation,
            lambda: evaluate(
                problem,
                choose(proposal.z, z),
                choose(proposal.guess, rest),
                choose(proposal.before, rest),
                begun & proposal.precise,
            ),
        )
        first = initial_state(settings, z, tried)
        decided = decide(problem, settings, state, proposal, tried)
        state = jax.tree.map(choose, decided, first)
        error = jnp.sqrt(2.0 * state.evaluation.cost)
        return jnp.ones((), bool), state, errors.at[state.step].set(error)

    begin = (jnp.zeros((), bool), initial_state(settings, z, empty), errors)
    _, state, errors = jax.lax.while_loop(going, step, begin)
    return as_run(state, errors)


def as_run(state: CalibrationState, errors: Float[Array, " n_steps"]) -> Run:
    """A run at its end."""
    return Run(
        state.z,
        state.evaluation.cost,
        jnp.maximum(state.step, 1),
        state.converged,
        errors,
    )


def better(best: Run, new: Run) -> Run:
    """The lower of two ends, with the steps of both; the errors of the first run."""
    # A run that is only finished may end where it was, to rounding.
    same = new.converged & ~best.converged & (new.cost <= 1.000001 * best.cost + 1e-9)
    lower = (new.cost < best.cost) | same
    keep = lambda a, b: jnp.where(lower, a, b)
    first = best.steps == 0
    return Run(
        keep(new.z, best.z),
        keep(new.cost, best.cost),
        best.steps + new.steps,
        keep(new.converged, best.converged),
        jnp.where(first, new.errors, best.errors),
    )
