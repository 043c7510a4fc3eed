"""Open-loop inverse control: the actuation that reaches goals (paper Eq. 6)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Float
from softcal_jax.configurations import (
    Configuration,
    EffectorRecord,
    configuration_lanes,
)
from softcal_jax.control._decision import ROUNDING
from softcal_jax.control._goals import Goal, goal_levels, with_goals
from softcal_jax.control._limits import Limits, active_limits, limit_arrays
from softcal_jax.control._outcomes import OUTCOMES
from softcal_jax.control._problem import ControlProblem, follow_room, linearise
from softcal_jax.control._result import (
    GoalFit,
    InverseResult,
    StepRecord,
    TrajectoryResult,
    imposed,
)
from softcal_jax.control._step import (
    ControlSettings,
    ControlState,
    control_step,
    start_control,
)
from softcal_jax.equilibrium import Model

_start = eqx.filter_jit(start_control)
_step = eqx.filter_jit(control_step)


def solve_inverse(
    model: Model,
    configuration: Configuration,
    *,
    goals: Mapping[str, Goal] | None = None,
    limits: Mapping[str, Limits] | None = None,
    priorities: Mapping[str, int] | None = None,
    settings: ControlSettings | None = None,
    guess: Float[Array, "n_points 3"] | None = None,
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
        guess = jnp.zeros((model.n_points, 3))
    result = _run(command, guess)
    if throw:
        _check(result)
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
        configuration: Where the first command starts; see `solve_inverse`.
        goals: Goals by name, for each point of the trajectory.
        limits: Limits of actuators; `step` holds between neighbouring points.
        priorities: Level of each effector.
        settings: Settings.
        throw: Raise at the first search that fails, see `solve_inverse`.

    Returns:
        The commands, up to the first one without an equilibrium.

    Raises:
        ValueError: As `solve_inverse`.
        RuntimeError: As `solve_inverse`.
    """
    points: list[InverseResult] = []
    now, guess = configuration, jnp.zeros((model.n_points, 3))
    for goal in goals:
        aimed = replace(configuration, actuation=now.actuation)
        result = solve_inverse(
            model,
            aimed,
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


class _Command(NamedTuple):
    """A command as the user gave it, and as arrays."""

    configuration: Configuration
    effectors: tuple[EffectorRecord, ...]
    priorities: Mapping[str, int]
    problem: ControlProblem
    settings: ControlSettings


def _prepare(model, configuration, goals, limits, priorities, settings) -> _Command:
    """Check a command and build its arrays."""
    if not configuration.actuation:
        known = ", ".join(map(repr, model.mechanism.actuators.names)) or "none"
        raise ValueError(
            f"configuration {configuration.name!r} commands no actuator: name those to "
            f"be commanded in `actuation`, where they start. Actuators: {known}."
        )
    settings = ControlSettings() if settings is None else settings
    priorities = {} if priorities is None else priorities
    configuration = with_goals(configuration, {} if goals is None else goals)
    mesh, mechanism = model.mesh, model.mechanism
    allowed = limit_arrays(mechanism, configuration, {} if limits is None else limits)
    lanes = configuration_lanes(mesh, [configuration], mechanism)
    arrays = jax.tree.map(lambda leaf: leaf[0], lanes.arrays)
    problem = ControlProblem(
        model=model,
        configuration=arrays,
        limits=jax.tree.map(jnp.asarray, allowed),
        start=arrays.actuation.value,
        levels=jnp.asarray(goal_levels(lanes, configuration.name, priorities)),
        epsilon=jnp.asarray(settings.epsilon),
    )
    (effectors,) = lanes.effectors
    return _Command(
        configuration=configuration,
        effectors=effectors,
        priorities=priorities,
        problem=problem,
        settings=settings,
    )


def _run(command: _Command, guess: Float[Array, "n_points 3"]) -> InverseResult:
    """Run the search, one compiled step after the other."""
    problem, settings = command.problem, command.settings
    # Tolerances are traced and unused settings fixed, so that neither recompiles.
    of_program = replace(settings, epsilon=0.0, max_steps=1)
    of_program = jax.tree.map(jnp.asarray, of_program)
    state = _start(problem, guess, of_program)
    if not bool(state.solution.converged):
        return _result(command, state, OUTCOMES.no_equilibrium, ())
    records = []
    while (outcome := _outcome(state, settings)) is None:
        state = _step(problem, of_program, state)
        records.append(
            StepRecord(
                size=float(state.last_step),
                cost=float(state.cost),
                violation=float(state.violation),
                kkt_residual=float(state.kkt_residual),
                newton_steps=int(state.newton_steps),
                accepted=bool(state.accepted),
            )
        )
    return _result(command, state, outcome, tuple(records))


def _outcome(state: ControlState, settings: ControlSettings) -> OUTCOMES | None:
    """Determine how the search has ended; None while it goes on."""
    if bool(state.met) and (settings.epsilon == 0.0 or bool(state.vanished)):
        return OUTCOMES.met
    if bool(state.vanished):
        return OUTCOMES.nearest
    if bool(state.stalled):
        violated = float(state.violation) > ROUNDING
        return OUTCOMES.limits_violated if violated else OUTCOMES.stalled
    if int(state.step) >= settings.max_steps:
        return OUTCOMES.max_steps
    return None


def _result(
    command: _Command,
    state: ControlState,
    outcome: OUTCOMES,
    records: tuple[StepRecord, ...],
) -> InverseResult:
    problem, mechanism = command.problem, command.problem.model.mechanism
    names = mechanism.actuators.names
    value = np.asarray(state.value)
    actuation = imposed(command.configuration, names, value)
    configuration = replace(command.configuration, actuation=actuation)
    of_actuators = state.compliance.state
    by_name = lambda values: dict(zip(names, map(float, values), strict=True))
    return InverseResult(
        outcome=outcome,
        configuration=configuration,
        solution=state.solution,
        goals=_goal_fits(command, np.asarray(of_actuators.effectors)),
        forces=by_name(of_actuators.forces),
        displacements=by_name(of_actuators.displacements),
        active_limits=_active(problem, state),
        steps=records,
    )


def _active(problem: ControlProblem, state: ControlState) -> tuple[str, ...]:
    """List the limits that are reached, in words."""
    if not bool(state.solution.converged):
        return ()
    linear = linearise(problem, state.value, state.compliance)
    lower, upper = problem.box()
    room = follow_room(problem, state.compliance.state, linear.length)
    of_inputs = [
        (state.value - lower) / linear.scale,
        (upper - state.value) / linear.scale,
    ]
    room = np.concatenate([np.stack(of_inputs), np.asarray(room).reshape(2, -1)])
    active = (room <= 10.0 * ROUNDING) & np.asarray(upper > lower)
    gone = np.abs(np.asarray(state.value - problem.start))
    step = np.asarray(problem.limits.step)
    by_displacement = np.asarray(problem.configuration.actuation.by_displacement)
    return active_limits(
        problem.model.mechanism, by_displacement, active, gone >= step * (1.0 - 1e-12)
    )


def _goal_fits(command: _Command, reached) -> tuple[GoalFit, ...]:
    """Compare every effector that has a goal with that goal; frames have two rows."""
    return tuple(
        GoalFit(
            replace(effector, simulated=effector.among(reached)),
            command.priorities.get(effector.name, 1),
        )
        for effector in command.effectors
        if effector.seen.any()
    )


def _check(result: InverseResult) -> None:
    if result.outcome == OUTCOMES.no_equilibrium:
        raise RuntimeError(f"{result.message} {RESULTS[result.solution.result]}.")
    if not (result.met or result.outcome == OUTCOMES.nearest):
        raise RuntimeError(result.message)
