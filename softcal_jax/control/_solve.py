"""Open-loop inverse control: the actuation that reaches goals (paper Eq. 6)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._results import RESULTS
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import QPStep
from softcal_jax.configurations import Configuration, configuration_lanes
from softcal_jax.control._goals import Goal, goal_levels, with_goals
from softcal_jax.control._limits import Limits, limit_arrays
from softcal_jax.control._problem import (
    Command,
    Linear,
    follow_room,
    level_errors,
    linearise,
    parts,
)
from softcal_jax.control._qp import step_in_levels
from softcal_jax.control._result import (
    OUTCOMES,
    GoalFit,
    InverseResult,
    StepRecord,
    TrajectoryResult,
)
from softcal_jax.control._step import (
    ROUNDING,
    Arrival,
    ControlSettings,
    Decision,
    Trial,
    arrive,
    decide,
)
from softcal_jax.equilibrium import Model


def solve_inverse(
    model: Model,
    configuration: Configuration,
    *,
    goals: Mapping[str, Goal] | None = None,
    limits: Mapping[str, Limits] | None = None,
    priorities: Mapping[str, int] | None = None,
    settings: ControlSettings | None = None,
    guess: Float[ArrayLike, "n_points 3"] | None = None,
    throw: bool = True,
) -> InverseResult:
    """Find the actuation that brings effectors to their goals, or nearest to them.

    Repeats the bounded QP of Eq. (6), min ||W_ea dl + e - goal||^2 plus epsilon times
    the energy of the actuators, until the goals are met or no step comes closer. Each
    step is tried on the true equilibrium, warm-started by the predicted displacement,
    and kept only if it helps. The result is a local optimum. Cables with an imposed
    displacement stay taut: slack ones are wound up, and none becomes slack.

    Args:
        model: The model, calibrated or not.
        configuration: The actuators in its `actuation` are commanded, by force or by
            displacement as imposed there, and start there; the others stay. Measured
            values of its effectors and markers are their goals, and errors are weighted
            by 1 / `std`.
        goals: Goals by the names of effectors and markers, in place of measured values;
            see `Goal`.
        limits: Limits by the names of actuators.
        priorities: Level of each effector, 1 by default. Level 1 is served first, and a
            later level never worsens an earlier one.
        settings: Settings.
        guess: Displacement near the equilibrium at the start; at rest by default [m].
        throw: Raise if the search fails; an unreachable goal is not a failure.

    Returns:
        The actuation, with its outcome.

    Raises:
        ValueError: If no actuator is commanded, no effector has a goal, a name is
            unknown, a goal has the wrong number of coordinates, or limits clash.
        RuntimeError: If there is no equilibrium at the start, or the search does not
            end at an optimum within the limits.
    """
    command = _prepare(model, configuration, goals, limits, priorities, settings)
    if guess is None:
        guess = np.zeros((model.n_points, 3))
    result = _search(command, np.asarray(guess))
    if throw and result.outcome == OUTCOMES.no_equilibrium:
        raise RuntimeError(f"{result.message} {RESULTS[result.solution.result]}.")
    if throw and not (result.met or result.outcome == OUTCOMES.nearest):
        raise RuntimeError(result.message)
    return result


def follow_trajectory(
    model: Model,
    configuration: Configuration,
    goals: Sequence[Mapping[str, Goal]],
    *,
    limits: Mapping[str, Limits] | None = None,
    priorities: Mapping[str, int] | None = None,
    settings: ControlSettings | None = None,
    throw: bool = True,
) -> TrajectoryResult:
    """Find the actuation for a sequence of goals, each from where the last one ended.

    Args:
        model: The model.
        configuration: Where the first command starts.
        goals: Goals by name, for each point of the trajectory.
        limits: Limits of actuators; `step` holds between neighbouring points.
        priorities: Level of each effector.
        settings: Settings.
        throw: As `solve_inverse`.

    Returns:
        The commands, up to the first one without an equilibrium.

    Raises:
        ValueError: As `solve_inverse`.
        RuntimeError: As `solve_inverse`, at the first search that fails.
    """
    points: list[InverseResult] = []
    now, guess = configuration, None
    for goal in goals:
        result = solve_inverse(
            model,
            replace(configuration, actuation=now.actuation),
            goals=goal,
            limits=limits,
            priorities=priorities,
            settings=settings,
            guess=guess,
            throw=throw,
        )
        points.append(result)
        if result.outcome == OUTCOMES.no_equilibrium:
            break
        now, guess = result.configuration, result.solution.displacement
    return TrajectoryResult(tuple(points))


def _prepare(model, configuration, goals, limits, priorities, settings) -> Command:
    """Check a command and build its arrays."""
    if not configuration.actuation:
        known = ", ".join(map(repr, model.mechanism.actuators.names)) or "none"
        raise ValueError(
            f"configuration {configuration.name!r} commands no actuator: name those to "
            f"be commanded in `actuation`, where they start. Actuators: {known}."
        )
    settings, priorities = settings or ControlSettings(), priorities or {}
    configuration = with_goals(configuration, goals or {})
    allowed = limit_arrays(model.mechanism, configuration, limits or {})
    lanes = configuration_lanes(model.mesh, [configuration], model.mechanism)
    return Command(
        model=model,
        configuration=configuration,
        lane=jax.tree.map(lambda leaf: leaf[0], lanes.arrays),
        effectors=lanes.effectors[0],
        limits=allowed,
        priorities=priorities,
        levels=goal_levels(lanes, configuration.name, priorities),
        settings=settings,
    )


def _search(command: Command, guess: Float[HostArray, "n_points 3"]) -> InverseResult:
    """Repeat: linearise, solve the QPs, try the step, keep it if it helps."""
    settings, box = command.settings, command.box()

    def arrived(value, guess) -> Arrival:
        model, lane = command.model, command.lane
        value, guess = jnp.asarray(value), jnp.asarray(guess)
        found = arrive(model, lane, jnp.asarray(box), value, guess, settings.newton)
        return found._replace(value=np.asarray(found.value))

    here = arrived(command.start, guess)
    if not here.stands:
        return _result(command, here, None, OUTCOMES.no_equilibrium, [])
    decision = Decision(
        accepted=True,
        step_bound=settings.step_bound,
        penalty=np.ones(len(command.levels) + 1),
    )
    linear, records = linearise(command, here.value, here.compliance), []
    while (outcome := _outcome(command, here, linear, decision, records)) is None:
        levels = tuple(zip(linear.W, linear.error, strict=True))
        qp = step_in_levels(levels, linear.rows, jnp.asarray(decision.step_bound))
        change = np.asarray(qp.lambda_p) * linear.scale
        moved = np.tensordot(change, here.compliance.displacement, axes=1)
        there = arrived(
            np.clip(here.value + change, *box),
            np.asarray(here.solution.displacement) + moved,
        )
        trial = _trial(command, linear, qp, there, decision)
        decision = decide(trial, decision, settings)
        if decision.accepted:
            here = there
            linear = linearise(command, here.value, here.compliance)
        violation, *costs = parts(linear.rows.b, linear.error)
        records.append(
            StepRecord(
                size=trial.size,
                cost=float(sum(costs)),
                violation=float(violation),
                kkt_residual=trial.kkt_residual,
                newton_steps=int(there.solution.steps),
                accepted=decision.accepted,
            )
        )
    return _result(command, here, linear, outcome, records)


def _trial(
    command: Command,
    linear: Linear,
    qp: QPStep,
    there: Arrival,
    before: Decision,
) -> Trial:
    """Compare the parts before a step with what was expected and what came of it."""
    rows, error, step = linear.rows, linear.error, np.asarray(qp.lambda_p)
    change = linear.W @ step
    now = parts(rows.b, error)
    tried = np.full_like(now, np.inf)
    if there.stands:
        state = there.compliance.state
        room = follow_room(command, state, linear.length)
        tried = parts(room, level_errors(command, state, linear.energy))
    weight = before.penalty[1:, None]
    lengths = np.sum(weight * change**2) * np.sum(weight * error**2)
    length = np.sqrt(max(lengths, np.finfo(float).tiny))
    return Trial(
        now=now,
        expected=parts(rows.b - rows.A @ step, error + change),
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
    kept_limits = parts(linear.rows.b, linear.error)[0] <= ROUNDING
    met = error <= settings.tol and kept_limits
    if met and (settings.epsilon == 0.0 or decision.vanished):
        return OUTCOMES.met
    if decision.vanished:
        return OUTCOMES.nearest
    if decision.stalled:
        return OUTCOMES.stalled if kept_limits else OUTCOMES.limits_violated
    return OUTCOMES.max_steps if len(records) >= settings.max_steps else None


def _result(
    command: Command,
    here: Arrival,
    linear: Linear | None,
    outcome: OUTCOMES,
    records: Sequence[StepRecord],
) -> InverseResult:
    names = command.model.mechanism.actuators.names
    by_name = lambda values: dict(zip(names, map(float, values), strict=True))
    inputs, state = by_name(here.value), here.compliance.state
    asked = command.configuration.actuation
    actuation = {a: replace(asked[a], value=inputs[a]) for a in asked}
    reached = np.asarray(state.effectors)
    # Every effector that has a goal is compared with it; frames have two rows.
    goals = tuple(
        GoalFit(
            replace(effector, simulated=effector.among(reached)),
            command.priorities.get(effector.name, 1),
        )
        for effector in command.effectors
        if effector.seen.any()
    )
    return InverseResult(
        outcome=outcome,
        configuration=replace(command.configuration, actuation=actuation),
        solution=here.solution,
        goals=goals,
        forces=by_name(state.forces),
        displacements=by_name(state.displacements),
        active_limits=() if linear is None else _active(command, here, linear),
        steps=tuple(records),
    )


def _active(command: Command, here: Arrival, linear: Linear) -> tuple[str, ...]:
    """List the limits that are reached, in words."""
    lower, upper = command.box()
    of_inputs = [here.value - lower, upper - here.value] / linear.scale
    of_rest = follow_room(command, here.compliance.state, linear.length)
    room = np.concatenate([of_inputs, of_rest.reshape(2, -1)])
    active = (room <= 10.0 * ROUNDING) & (upper > lower)
    step = command.limits.step * (1.0 - 1e-12)
    step_reached = np.abs(here.value - command.start) >= step
    by_displacement = np.asarray(command.lane.actuation.by_displacement)
    actuators, found = command.model.mechanism.actuators, []
    for a, row in np.argwhere(active.T):
        of_input, side = row < 2, ("lower", "upper")[row % 2]
        what = "displacement" if by_displacement[a] == of_input else "force"
        if of_input and step_reached[a]:
            what, side = f"step of the {what}", "longest"
        noun, name = actuators.kinds[a].noun, actuators.names[a]
        found.append(f"{what} of {noun} {name!r} at its {side} limit")
    return tuple(found)
