"""One descent of inverse control: steps from one start towards one aim."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._results import RESULTS
from softcal_jax._typing import Float, HostArray
from softcal_jax.control._inputs import (
    ActuatorCompliance,
    ActuatorReadings,
    actuator_compliance,
    actuator_readings,
    with_inputs,
)
from softcal_jax.control._result import OUTCOMES, StepRecord
from softcal_jax.control._step import (
    ROUNDING,
    Command,
    Decision,
    Linear,
    all_errors,
    decide,
    follow_room,
    limited_step,
    linearise,
    parts,
    violation,
)
from softcal_jax.equilibrium import EquilibriumSolution, solve_equilibrium

PATIENCE = 3
"""Steps in a row of an exploring descent of which some must come closer."""

CLOSER = 0.5
"""Largest ratio of the costs after and before these steps that counts as closer [-]."""


NOWHERE = np.full(2, np.inf)
"""The parts of a step that leads to no equilibrium."""


class Reached(NamedTuple):
    """The equilibrium at some inputs, slack cables wound up, and the readings there."""

    value: Float[HostArray, " n_a"]
    solution: EquilibriumSolution
    state: ActuatorReadings


class Arrival(NamedTuple):
    """An equilibrium with its derivatives, which are nan where there is none."""

    value: Float[HostArray, " n_a"]
    solution: EquilibriumSolution
    compliance: ActuatorCompliance

    @property
    def stands(self) -> bool:
        return bool(np.isfinite(self.compliance.W_ea).all())


class Descent(NamedTuple):
    """Where a descent is, what followed from its last step, and how it ended.

    `linear` is None without derivatives, `outcome` while it can go on.
    """

    arrival: Arrival
    linear: Linear | None
    decision: Decision
    outcome: OUTCOMES | None = None
    records: tuple[StepRecord, ...] = ()

    @property
    def met(self) -> bool:
        return self.outcome is not None and bool(self.outcome == OUTCOMES.met)


def reached(
    command: Command,
    value: Float[HostArray, " n_a"],
    guess: Float[HostArray, "n_points 3"],
) -> Reached:
    """Solve for the equilibrium at inputs within their limits; wind up slack cables.

    Winding them up until they are just taut does not change the equilibrium, but a
    slack cable has no effect on the robot and so no derivative, whereas a taut one has.
    """
    lower, upper = command.box()
    value = np.clip(value, lower, upper)
    lane = with_inputs(command.lane, jnp.asarray(value))
    start, newton = jnp.asarray(guess), command.settings.newton
    solution = solve_equilibrium(command.model, lane, guess=start, settings=newton)
    state = _readings(command.model, lane, solution)
    wound = np.maximum(value, np.minimum(state.displacements, upper))
    cable = command.model.mechanism.actuators.unilateral
    cable = cable & np.asarray(lane.actuation.by_displacement) & (upper > lower)
    return Reached(np.where(cable, wound, value), solution, state)


_readings = eqx.filter_jit(actuator_readings)


def differentiated(command: Command, equilibrium: Reached) -> Arrival:
    """Add the derivatives. A factorization: only worth it for a step that is kept."""
    lane = with_inputs(command.lane, jnp.asarray(equilibrium.value))
    compliance = actuator_compliance(command.model, lane, equilibrium.solution)
    return Arrival(equilibrium.value, equilibrium.solution, compliance)


def moved(command: Command, base: Arrival, change: Float[HostArray, " n_a"]) -> Reached:
    """Solve for the equilibrium after a change of the inputs, from its prediction."""
    motion = np.tensordot(change, base.compliance.displacement, axes=1)
    guess = np.asarray(base.solution.displacement) + motion
    return reached(command, base.value + change, guess)


def begin(command: Command, arrival: Arrival) -> Descent:
    decision = Decision(
        accepted=True, step_bound=command.settings.step_bound, penalty=1.0
    )
    if not arrival.stands:
        result = arrival.solution.result
        singular = (result == RESULTS.converged) | (result == RESULTS.singular)
        outcome = OUTCOMES.singular if bool(singular) else OUTCOMES.no_equilibrium
        return Descent(arrival, None, decision, outcome)
    linear = linearise(command, arrival.value, arrival.compliance)
    outcome = _outcome(command, arrival, linear, decision, [])
    return Descent(arrival, linear, decision, outcome)


def descend(command: Command, start: Descent, *, explore: bool = False) -> Descent:
    """Repeat: linearise, solve the QP, try the step, keep it if it helps.

    With `explore` it stops once steps hardly come closer any more. Near a goal that is
    met, the error falls tenfold with each step; at a fold of the map from inputs to
    effectors, most steps are spent on the last digits of a minimum.
    """
    arrival, linear, decision, outcome, records = start
    settings, records = command.settings, list(records)
    while outcome is None and not (explore and _slow(records)):
        assert linear is not None
        qp = limited_step(linear, jnp.asarray(decision.step_bound))
        step = np.asarray(qp.lambda_p)
        equilibrium = moved(command, arrival, step * linear.scale)
        tried, before = _parts_at(command, linear, equilibrium), decision
        decision = decide(linear, qp, tried, before, settings)
        if decision.accepted:
            candidate = differentiated(command, equilibrium)
            if candidate.stands:
                arrival = candidate
                linear = linearise(command, arrival.value, arrival.compliance)
            else:
                # A singular equilibrium counts as none: no step leads on from it.
                decision = decide(linear, qp, NOWHERE, before, settings)
        records.append(
            StepRecord(
                size=float(np.abs(step).max()),
                cost=0.5 * float((linear.error**2).sum()),
                violation=violation(linear.b),
                kkt_residual=float(qp.kkt_residual),
                newton_steps=int(equilibrium.solution.steps),
                accepted=decision.accepted,
            )
        )
        outcome = _outcome(command, arrival, linear, decision, records)
    return Descent(arrival, linear, decision, outcome, tuple(records))


def _slow(records: Sequence[StepRecord]) -> bool:
    if len(records) <= PATIENCE:
        return False
    before, now = records[-1 - PATIENCE], records[-1]
    return (
        now.cost > CLOSER * before.cost and now.violation >= CLOSER * before.violation
    )


def _parts_at(command: Command, linear: Linear, at: Reached) -> Float[HostArray, "2"]:
    """Compute the parts as they turned out after a step."""
    if not bool(at.solution.converged):
        return NOWHERE
    room = follow_room(command, at.state, linear.length)
    return parts(room, all_errors(command, at.state, linear.energy))


def _outcome(
    command: Command,
    arrival: Arrival,
    linear: Linear,
    decision: Decision,
    records: Sequence[StepRecord],
) -> OUTCOMES | None:
    """Determine how the search has ended; None while it goes on."""
    settings = command.settings
    error = np.abs(command.residuals(arrival.compliance.state)).max()
    kept_limits = violation(linear.b) <= ROUNDING
    met = error <= settings.tol and kept_limits
    if met and (settings.epsilon == 0.0 or decision.vanished):
        return OUTCOMES.met
    if decision.vanished:
        return OUTCOMES.nearest
    if decision.stalled:
        return OUTCOMES.stalled if kept_limits else OUTCOMES.limits_violated
    return OUTCOMES.max_steps if len(records) >= settings.max_steps else None
