"""Open-loop inverse control: the actuation that reaches goals (paper Eq. 6)."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

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
from softcal_jax.control._descent import Descent
from softcal_jax.control._goals import Goal, goal_weights, with_goals
from softcal_jax.control._holding import Holding, what_holds
from softcal_jax.control._limits import Limits, limit_arrays
from softcal_jax.control._problem import Command
from softcal_jax.control._result import (
    OUTCOMES,
    Attempt,
    GoalFit,
    InverseResult,
    TrajectoryResult,
)
from softcal_jax.control._search import search
from softcal_jax.control._step import ControlSettings
from softcal_jax.equilibrium import Model, actuator_states


class ControlWarning(SoftcalWarning):
    """A goal that is probably a mistake."""


def solve_inverse(
    model: Model,
    configuration: Configuration,
    *,
    goals: Mapping[str, Goal] | None = None,
    limits: Mapping[str, Limits] | None = None,
    settings: ControlSettings | None = None,
    guess: Float[ArrayLike, "n_points 3"] | None = None,
    throw: bool = True,
) -> InverseResult:
    """Find the actuation that brings effectors to their goals, or nearest to them.

    Repeats the bounded QP of Eq. (6), min ||W_ea dl + e - goal||^2 plus epsilon times
    the energy of the actuators, until the goals are met or no step comes closer. Each
    step is tried on the true equilibrium, and kept only if it helps. If that does not
    meet the goals, they are approached from other starts within the limits, and over a
    continuation; the result is the best end, and what holds it there. Cables with an
    imposed displacement stay taut: slack ones are wound up, and none becomes slack.

    Args:
        model: The model, calibrated or not.
        configuration: The actuators in its `actuation` are commanded and start there;
            other actuators stay as they are. Measured values of its effectors and
            markers are their goals, and errors are weighted by 1 / `std`.
        goals: Goals by the names of effectors and markers, in place of measured values;
            see `Goal`.
        limits: Limits by the names of actuators.
        settings: Settings.
        guess: Displacement near the equilibrium at the start; at rest by default [m].
        throw: Raise if the search fails; an unreachable goal is not a failure.

    Raises:
        ValueError: If no actuator is commanded, no effector has a goal, a name is
            unknown, a goal has the wrong number of coordinates, or limits clash.
        RuntimeError: If there is no equilibrium at the start or a singular one, or the
            search does not end at an optimum within the limits.

    Warns:
        ControlWarning: If a goal is farther away than the robot is large.
    """
    command = _prepare(model, configuration, goals, limits, settings)
    if guess is None:
        guess = np.zeros((model.n_points, 3))
    result = _result(command, *search(command, np.asarray(guess)))
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
    settings: ControlSettings | None = None,
    throw: bool = True,
) -> TrajectoryResult:
    """Find the actuation for a sequence of goals, each from where the last one ended.

    Arguments and errors are those of `solve_inverse`, with `goals` for each point of
    the trajectory; the `step` of limits holds between neighbouring points.

    Returns:
        The commands, up to the first one whose start has no regular equilibrium.
    """
    points: list[InverseResult] = []
    now, guess = configuration, None
    for goal in goals:
        result = solve_inverse(
            model,
            replace(configuration, actuation=now.actuation),
            goals=goal,
            limits=limits,
            settings=settings,
            guess=guess,
            throw=throw,
        )
        points.append(result)
        if result.outcome in (OUTCOMES.no_equilibrium, OUTCOMES.singular):
            break
        now, guess = result.configuration, result.solution.displacement
    return TrajectoryResult(tuple(points))


def _prepare(model, configuration, goals, limits, settings) -> Command:
    if not configuration.actuation:
        known = ", ".join(map(repr, model.mechanism.actuators.names)) or "none"
        raise ValueError(
            f"configuration {configuration.name!r} commands no actuator: name some in "
            f"`actuation`, where they start. Actuators: {known}."
        )
    settings = settings or ControlSettings()
    configuration = with_goals(configuration, goals or {})
    allowed = limit_arrays(model.mechanism, configuration, limits or {})
    lanes = configuration_lanes(model.mesh, [configuration], model.mechanism)
    far = farthest(motions(lanes.effectors[0]), model.mesh.size)
    if far is not None:
        warnings.warn(f"the goal of {far}", ControlWarning, stacklevel=3)
    return Command(
        model=model,
        configuration=configuration,
        lane=lanes.arrays[0],
        effectors=lanes.effectors[0],
        limits=allowed,
        weights=goal_weights(lanes, configuration.name),
        settings=settings,
    )


def _result(
    command: Command, best: Descent, attempts: tuple[Attempt, ...]
) -> InverseResult:
    arrival, linear, _, outcome, records = best
    assert outcome is not None
    model, state = command.model, arrival.compliance.state
    inputs = dict(zip(model.mechanism.actuators.names, arrival.value, strict=True))
    asked = command.configuration.actuation
    actuation = {a: replace(asked[a], value=float(inputs[a])) for a in asked}
    reached = np.asarray(state.effectors)
    # Every effector that has a goal is compared with it; frames have two rows.
    goals = tuple(
        GoalFit(replace(effector, simulated=effector.among(reached)))
        for effector in command.effectors
        if effector.seen.any()
    )
    holding = Holding()
    if linear is not None:
        holding = what_holds(command, arrival, linear)
    return InverseResult(
        outcome=outcome,
        configuration=replace(command.configuration, actuation=actuation),
        solution=arrival.solution,
        goals=goals,
        actuators=actuator_states(
            model, command.lane, state.forces, state.displacements
        ),
        **holding._asdict(),
        steps=records,
        attempts=attempts,
        tol=command.settings.tol,
        model=model,
    )
