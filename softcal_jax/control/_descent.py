"""One descent of inverse control: steps from one start towards one aim."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration import QPStep
from softcal_jax.control._problem import (
    Command,
    Linear,
    follow_room,
    level_errors,
    linearise,
    parts,
    violation,
)
from softcal_jax.control._qp import step_in_levels
from softcal_jax.control._result import OUTCOMES, StepRecord
from softcal_jax.control._step import (
    ROUNDING,
    Arrival,
    Decision,
    Reached,
    TriedStep,
    decide,
    differentiate,
    reach,
)

PATIENCE = 3
"""Steps in a row of an exploring descent of which some must come closer."""

CLOSER = 0.5
"""Largest ratio of the costs after and before them that counts as closer [-]."""


class Descent(NamedTuple):
    """Where a descent is.

    Attributes:
        here: The equilibrium there.
        linear: The command linearised there; None without derivatives.
        decision: What followed from its last step.
        outcome: How it ended; None while it can go on.
        records: Its steps.
    """

    here: Arrival
    linear: Linear | None
    decision: Decision
    outcome: OUTCOMES | None = None
    records: tuple[StepRecord, ...] = ()

    @property
    def met(self) -> bool:
        """Whether it ended where all goals are met."""
        return self.outcome is not None and bool(self.outcome == OUTCOMES.met)


def reached(
    command: Command,
    value: Float[Array | HostArray, " n_a"],
    guess: Float[Array | HostArray, "n_points 3"],
) -> Reached:
    """Solve for the equilibrium at inputs, which are clipped to their limits."""
    box = command.box()
    return reach(
        command.model,
        command.lane,
        jnp.asarray(box),
        jnp.asarray(np.clip(value, *box)),
        jnp.asarray(guess),
        command.settings.newton.as_arrays(),
    )


def differentiated(command: Command, there: Reached) -> Arrival:
    """Add the derivatives to an equilibrium."""
    found = differentiate(command.model, command.lane, there)
    return found._replace(value=np.asarray(found.value))


def moved(command: Command, here: Arrival, change: Float[HostArray, " n_a"]) -> Reached:
    """Solve for the equilibrium after a change of the inputs, from its prediction."""
    motion = np.tensordot(change, here.compliance.displacement, axes=1)
    guess = np.asarray(here.solution.displacement) + motion
    return reached(command, here.value + change, guess)


def begin(command: Command, here: Arrival) -> Descent:
    """Return the descent before its first step."""
    decision = Decision(
        accepted=True,
        step_bound=command.settings.step_bound,
        penalty=np.ones(len(command.levels) + 1),
    )
    if not here.stands:
        result = here.solution.result
        singular = (result == RESULTS.converged) | (result == RESULTS.singular)
        outcome = OUTCOMES.singular if bool(singular) else OUTCOMES.no_equilibrium
        return Descent(here, None, decision, outcome)
    linear = linearise(command, here.value, here.compliance)
    outcome = _outcome(command, here, linear, decision, [])
    return Descent(here, linear, decision, outcome)


def descend(command: Command, start: Descent, *, explore: bool = False) -> Descent:
    """Repeat: linearise, solve the QPs, try the step, keep it if it helps.

    Args:
        command: The command.
        start: Where it begins or goes on.
        explore: Stop where it hardly comes closer any more. Near a goal that is met,
            the error falls tenfold with each step; at a fold of the map from inputs to
            effectors, most steps are spent on the last digits of a minimum.
    """
    here, linear, decision, outcome, records = start
    settings, records = command.settings, list(records)
    while outcome is None and not (explore and _slow(records)):
        assert linear is not None
        levels = tuple(zip(linear.W, linear.error, strict=True))
        qp = step_in_levels(levels, linear.limits, jnp.asarray(decision.step_bound))
        there = moved(command, here, np.asarray(qp.lambda_p) * linear.scale)
        trial = _trial(command, linear, qp, there, decision)
        before, decision = decision, decide(trial, decision, settings)
        if decision.accepted:
            arrived = differentiated(command, there)
            if arrived.stands:
                here = arrived
                linear = linearise(command, here.value, here.compliance)
            else:
                # A singular equilibrium counts as none: no step leads on from it.
                trial = trial._replace(tried=np.full_like(trial.tried, np.inf))
                decision = decide(trial, before, settings)
        records.append(
            StepRecord(
                size=trial.size,
                cost=0.5 * float((linear.error**2).sum()),
                violation=violation(linear.limits.b),
                kkt_residual=trial.kkt_residual,
                newton_steps=int(there.solution.steps),
                accepted=decision.accepted,
            )
        )
        outcome = _outcome(command, here, linear, decision, records)
    return Descent(here, linear, decision, outcome, tuple(records))


def _slow(records: Sequence[StepRecord]) -> bool:
    """Tell whether the last steps hardly came closer, and kept the limits before."""
    if len(records) <= PATIENCE:
        return False
    before, now = records[-1 - PATIENCE], records[-1]
    return (
        now.cost > CLOSER * before.cost and now.violation >= CLOSER * before.violation
    )


def _trial(
    command: Command,
    linear: Linear,
    qp: QPStep,
    there: Reached,
    before: Decision,
) -> TriedStep:
    """Compare the parts before a step with what was expected and what came of it."""
    limits, error, step = linear.limits, linear.error, np.asarray(qp.lambda_p)
    change = linear.W @ step
    now = parts(limits.b, error)
    tried = np.full_like(now, np.inf)
    if bool(there.solution.converged):
        room = follow_room(command, there.state, linear.length)
        tried = parts(room, level_errors(command, there.state, linear.energy))
    weight = before.penalty[1:, None]
    lengths = np.sum(weight * change**2) * np.sum(weight * error**2)
    length = np.sqrt(max(lengths, np.finfo(float).tiny))
    return TriedStep(
        now=now,
        expected=parts(limits.b - limits.A @ step, error + change),
        tried=tried,
        size=float(np.abs(step).max()),
        kkt_residual=float(qp.kkt_residual),
        cosine=-np.sum(weight * change * error) / length,
    )


def _outcome(
    command: Command,
    here: Arrival,
    linear: Linear,
    decision: Decision,
    records: Sequence[StepRecord],
) -> OUTCOMES | None:
    """Determine how the search has ended; None while it goes on."""
    settings = command.settings
    error = np.abs(command.residuals(here.compliance.state)).max()
    kept_limits = violation(linear.limits.b) <= ROUNDING
    met = error <= settings.tol and kept_limits
    if met and (settings.epsilon == 0.0 or decision.vanished):
        return OUTCOMES.met
    if decision.vanished:
        return OUTCOMES.nearest
    if decision.stalled:
        return OUTCOMES.stalled if kept_limits else OUTCOMES.limits_violated
    return OUTCOMES.max_steps if len(records) >= settings.max_steps else None
