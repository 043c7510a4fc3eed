"""The outer loop step by step, the configurations of each side by side."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._evaluator import Evaluator
from softcal_jax.calibration._problem import Evaluation, first_guess
from softcal_jax.calibration._proposal import propose
from softcal_jax.calibration._runs import (
    Run,
    as_run,
    better,
    images_of,
    nothing_yet,
    origin,
    wanted,
)
from softcal_jax.calibration._state import (
    CalibrationSettings,
    CalibrationState,
    initial_state,
)
from softcal_jax.calibration._step import decide

# Several programs instead of one per step: the evaluation, which takes seconds to
# compile, serves the start and every step.
_first_guess = eqx.filter_jit(first_guess)
_propose = eqx.filter_jit(propose)
_decide = eqx.filter_jit(decide)
_images_of = eqx.filter_jit(images_of)
_wanted = eqx.filter_jit(wanted)
_better = eqx.filter_jit(better)
_origin = eqx.filter_jit(
    lambda space, *ends: space.admissible(origin(*ends))  # slow, step by step
)


def from_rest(evaluate: Evaluator, z: Float[Array, " n_p"]) -> Evaluation:
    """The evaluation at some parameters, from nothing but the configurations.

    Args:
        evaluate: Of the calibration.
        z: Scaled parameters [-].
    """
    return evaluate(z, _first_guess(evaluate.numbered, z))


def descend(
    evaluate: Evaluator,
    settings: CalibrationSettings,
    state: CalibrationState,
    note: Callable[[CalibrationState], None],
) -> CalibrationState:
    """Steps until lambda_p vanishes, none is left, or there were `max_steps`.

    Args:
        evaluate: Of the calibration.
        settings: Settings of the outer loop.
        state: State to begin with, its evaluation included.
        note: Called with the state after each step.
    """
    problem = evaluate.numbered
    while not (state.converged or state.stalled or not state.evaluation.ok) and (
        state.step < settings.max_steps
    ):
        proposal = _propose(problem, settings, state)
        tried = (
            state.evaluation
            if proposal.vanishes
            else evaluate(proposal.z, proposal.guess, proposal.before, proposal.precise)
        )
        state = _decide(problem, settings, state, proposal, tried)
        note(state)
    return state


def run_start(
    evaluate: Evaluator,
    settings: CalibrationSettings,
    start: Float[Array, " n_p"],
    *,
    mirror: bool,
) -> Run:
    """What `run_starts` gives for one start.

    Args:
        evaluate: Of the calibration.
        settings: Settings of the outer loop.
        start: Scaled parameters to start from [-].
        mirror: Whether it goes on from its mirror images.
    """
    problem = evaluate.numbered
    best, images = nothing_yet(settings, start), _images_of(problem.space, mirror)
    for row in range(len(images.signs)):
        image = jax.tree.map(lambda leaf, row=row: leaf[row], images)
        if not _wanted(problem, best, image):
            continue
        z = _origin(problem.space, best, image, start)
        state = initial_state(settings, z, from_rest(evaluate, z))
        errors = jnp.full_like(best.errors, jnp.nan)
        states = [state]
        state = descend(evaluate, settings, state, states.append)
        sizes = jnp.stack([jnp.sqrt(2.0 * s.evaluation.cost) for s in states])
        best = _better(best, as_run(state, errors.at[: len(sizes)].set(sizes)))
    return best
