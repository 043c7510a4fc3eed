"""The outer loop from one start: step after step until lambda_p vanishes."""

from collections.abc import Callable

import equinox as eqx
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration._evaluator import Evaluator
from softcal_jax.calibration._proposal import propose
from softcal_jax.calibration._state import (
    CalibrationSettings,
    CalibrationState,
    initial_state,
)
from softcal_jax.calibration._step import decide
from softcal_jax.equilibrium import Job

# Several programs instead of one per step: the evaluation, which takes seconds to
# compile, serves the start and every step.
_propose = eqx.filter_jit(propose)
_decide = eqx.filter_jit(decide)
_admissible = eqx.filter_jit(lambda space, z: space.admissible(z))


class Run(eqx.Module):
    """End of the outer loop.

    Attributes:
        z: Scaled parameters [-].
        cost: Half the sum of squared errors in noise units; infinite if the start has
            no equilibrium [-].
        steps: QP steps, those of mirrored runs included.
        converged: Whether lambda_p vanished.
        errors: Root of twice the cost after each step of the first run; nan after its
            end [-].
    """

    z: Float[HostArray, " n_p"]
    cost: float
    steps: int
    converged: bool
    errors: Float[HostArray, " n_steps"]


def descend(
    evaluate: Evaluator,
    settings: CalibrationSettings,
    state: CalibrationState,
    note: Callable[[CalibrationState], None],
) -> Job[CalibrationState]:
    """Take steps until lambda_p vanishes, every step is refused, or `max_steps`.

    Args:
        evaluate: Evaluator of the calibration.
        settings: Settings of the outer loop.
        state: State to begin with, its evaluation included.
        note: Called with the state after each step.
    """
    problem = evaluate.numbered
    while not (state.converged or state.stalled or not state.evaluation.ok) and (
        state.step < settings.max_steps
    ):
        proposal = _propose(problem, settings, state)
        tried = state.evaluation
        if not proposal.vanishes:
            tried = yield from evaluate(
                proposal.z, proposal.guess, proposal.before, proposal.precise
            )
        state = _decide(problem, settings, state, proposal, tried)
        note(state)
    return state


def minimise(
    evaluate: Evaluator, settings: CalibrationSettings, start: Float[Array, " n_p"]
) -> Job[Run]:
    """Run the outer loop from one start to its end.

    Args:
        evaluate: Evaluator of the calibration.
        settings: Settings of the outer loop.
        start: Scaled parameters to start from [-].
    """
    z = _admissible(evaluate.numbered.space, start)
    state = initial_state(settings, z, (yield from evaluate.from_rest(z)))
    costs = [float(state.evaluation.cost)]
    note = lambda state: costs.append(float(state.evaluation.cost))
    state = yield from descend(evaluate, settings, state, note)
    errors = np.full(settings.max_steps + 1, np.nan)
    errors[: len(costs)] = np.sqrt(2.0 * np.array(costs))
    return Run(
        z=np.asarray(state.z),
        cost=costs[-1],
        steps=max(int(state.step), 1),
        converged=bool(state.converged),
        errors=errors,
    )
