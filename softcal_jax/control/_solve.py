"""Open-loop inverse control: the actuation that reaches goals (paper Eq. 6)."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._results import RESULTS
from softcal_jax._typing import Float
from softcal_jax._warnings import SoftcalWarning
from softcal_jax.configurations import (
    Configuration,
    configuration_lanes,
    farthest,
    motions,
)
from softcal_jax.control._goals import Goal, goal_levels, with_goals
from softcal_jax.control._holding import Holding, what_holds
from softcal_jax.control._limits import Limits, limit_arrays
from softcal_jax.control._problem import Command
from softcal_jax.control._result import (
    OUTCOMES,
    GoalFit,
    InverseResult,
    TrajectoryResult,
)
from softcal_jax.control._search import Found, search
from softcal_jax.control._step import ControlSettings
from softcal_jax.equilibrium import Model


class ControlWarning(SoftcalWarning):
    """A goal that is probably a mistake."""


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
    and kept only if it helps. If that does not meet the goals, they are approached from
    other starts within the limits, and over a continuation; the best end counts.
    Where none meets them, the result says how far off it is in each direction, and
    which limits or blind direction hold it. Cables with an imposed displacement stay
    taut: slack ones are wound up, and none becomes slack.

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
        RuntimeError: If there is no equilibrium at the start or a singular one, or the
            search does not end at an optimum within the limits.

    Warns:
        ControlWarning: If a goal is farther away than the robot is large.
    """
    command = _prepare(model, configuration, goals, limits, priorities, settings)
    if guess is None:
        guess = np.zeros((model.n_points, 3))
    result = _result(command, search(command, np.asarray(guess)))
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
        The commands, up to the first one whose start has no regular equilibrium.

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
        if result.outcome in (OUTCOMES.no_equilibrium, OUTCOMES.singular):
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
    far = farthest(motions(lanes.effectors[0]), model.mesh.size)
    if far is not None:
        warnings.warn(f"the goal of {far}", ControlWarning, stacklevel=3)
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


def _result(command: Command, found: Found) -> InverseResult:
    here, linear, _, outcome, records = found.best
    assert outcome is not None
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
    holding = Holding((), (), None)
    if linear is not None:
        holding = what_holds(command, here, linear)
    return InverseResult(
        outcome=outcome,
        configuration=replace(command.configuration, actuation=actuation),
        solution=here.solution,
        goals=goals,
        forces=by_name(state.forces),
        displacements=by_name(state.displacements),
        active_limits=holding.active,
        held_by=holding.limits,
        blind=holding.blind,
        steps=records,
        attempts=found.attempts,
        tol=command.settings.tol,
        model=command.model,
    )
