"""Open-loop inverse control: the actuation that reaches goals (paper Eq. 6)."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax import _notebook
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable_values
from softcal_jax.calibration import Evaluation
from softcal_jax.configurations import Configuration, farthest, motions
from softcal_jax.control._command import Command, ControlSettings
from softcal_jax.control._goals import Goal, Limits, commanded, with_goals
from softcal_jax.control._inputs import actuator_readings
from softcal_jax.control._result import (
    OUTCOMES,
    Attempt,
    BlindDirection,
    InverseResult,
    TrajectoryResult,
    coordinate_names,
)
from softcal_jax.control._search import ControlWarning, Descent, search
from softcal_jax.equilibrium import Model, Workers, actuator_states, outcome_words

NO_MORE = "the end of its equilibria: a step further on there is none"

HOLDS = 1e-2
"""Cosine between the errors and what a limit forbids from which it holds them [-]."""

BLIND = 1e-2
"""Singular value of W_ea, relative to the largest, below which a direction is blind.

Inputs, counted as the motion of the robot that they cause, move the effectors a hundred
times less along it than along the best direction [-].
"""


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
    the energy of the actuators, until the goals are met or no step comes closer: the
    loop of `calibrate`, with the inputs for parameters. If that does not meet the
    goals, they are approached from other starts within the limits, and over a
    continuation; the result is the best end, and what holds it there. Cables with an
    imposed displacement stay taut: slack ones are wound up, and none becomes slack.

    Args:
        model: The model, calibrated or not.
        configuration: The actuators in its `actuation` are commanded and start there;
            other actuators stay as they are. Measured values of its effectors and
            markers are their goals, and errors are weighted by 1 / `std`.
        goals: Goals by the names of effectors and markers, in place of all measured
            values: a `Pose` from rest for a `BodyFrame`, three numbers for a point or
            reaction, one for a length, volume, angle or force; in SI units and radians.
            A marker may leave coordinates free: (nan, nan, 0.02).
        limits: Limits by the names of actuators.
        settings: Settings.
        guess: Displacement near the equilibrium at the start; at rest by default [m].
        throw: Raise if the search fails or is interrupted; an unreachable goal is not a
            failure.

    Raises:
        ValueError: If no actuator is commanded, no effector has a goal, a name is
            unknown, a goal has the wrong number of coordinates, limits clash, or they
            leave no actuator any room.
        RuntimeError: If there is no equilibrium at the start or a singular one, or the
            search does not end at an optimum within the limits.

    Warns:
        ControlWarning: If a goal is farther away than the robot is large, or the start
            has no equilibrium: then the search goes on from the largest share of its
            inputs that was found to have one.
    """
    rest = np.zeros((model.n_points, 3))
    with Workers(model, 1) as workers:
        robot = _prepared(model, configuration, goals, limits, settings, workers)
        best, attempts = search(robot, rest if guess is None else np.asarray(guess))
    result = _result(best, attempts)
    if not throw or result.met or result.outcome == OUTCOMES.nearest:
        return result
    why = _notebook.headline_of(result)
    if result.outcome == OUTCOMES.interrupted:
        raise KeyboardInterrupt(why)
    if result.outcome == OUTCOMES.no_equilibrium:
        why += f" {outcome_words(result.solution)}."
    raise RuntimeError(why)


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
        The commands, up to the first one whose start has no regular equilibrium, or
        to an interruption.

    Raises:
        ValueError: Also if there is no goal.
    """
    if len(goals) == 0:
        raise ValueError("goals is empty: give at least one point of the trajectory.")
    points: list[InverseResult] = []
    now, guess = configuration, None
    last = OUTCOMES.no_equilibrium, OUTCOMES.singular, OUTCOMES.interrupted
    try:
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
            if result.outcome in last:
                break
            now, guess = result.configuration, result.solution.displacement
    except KeyboardInterrupt:
        if throw or not points:
            raise
        points[-1] = replace(points[-1], outcome=OUTCOMES.interrupted)
    return TrajectoryResult(tuple(points))


def _prepared(
    model: Model,
    configuration: Configuration,
    goals: Mapping[str, Goal] | None,
    limits: Mapping[str, Limits] | None,
    settings: ControlSettings | None,
    workers: Workers,
) -> Command:
    if not configuration.actuation:
        known = ", ".join(map(repr, model.mechanism.actuators.names)) or "none"
        raise ValueError(
            f"configuration {configuration.name!r} commands no actuator: name some in "
            f"`actuation`, where they start. Actuators: {known}."
        )
    if goals is not None:
        configuration = with_goals(configuration, goals)
    inputs = commanded(model.mechanism, configuration, limits or {})
    settings = settings or ControlSettings()
    robot = Command(model, configuration, inputs, settings, workers)
    far = farthest(motions(robot.records), model.mesh.size)
    if far is not None:
        warnings.warn(f"the goal of {far}", ControlWarning, stacklevel=3)
    if not any(record.seen.any() for record in robot.records):
        names = dict.fromkeys(record.name for record in robot.records)
        raise ValueError(
            f"no effector of configuration {configuration.name!r} has a goal: give "
            "measured values, or `goals` by name. Effectors: "
            f"{', '.join(map(repr, names)) or 'none'}."
        )
    return robot


_readings = eqx.filter_jit(actuator_readings)


def _result(best: Descent, attempts: tuple[Attempt, ...]) -> InverseResult:
    robot, here, outcome = best.robot, best.here, best.outcome
    assert outcome is not None
    model, solution, lane = robot.problem.model, robot.solution(here), robot.lane(here)
    state = _readings(model, lane, solution)
    asked = robot.configuration.actuation
    inputs = dict(
        zip(model.mechanism.actuators.names, lane.actuation.value, strict=True)
    )
    actuation = {a: replace(asked[a], value=float(inputs[a])) for a in asked}
    reached = np.asarray(here.effectors)[0]
    # Every effector that has a goal is compared with it; frames have two rows.
    goals = tuple(
        replace(effector, simulated=effector.among(reached))
        for effector in robot.records
        if effector.seen.any()
    )
    # Where it was interrupted nothing holds the robot: more steps would have followed.
    stands = here.ok and outcome != OUTCOMES.interrupted
    holding = what_holds(robot, here) if stands else Holding()
    if stands and best.ended:
        holding = holding._replace(held_by=(*holding.held_by, NO_MORE))
    return InverseResult(
        outcome=outcome,
        configuration=replace(robot.configuration, actuation=actuation),
        solution=solution,
        goals=goals,
        actuators=actuator_states(model, lane, state.forces, state.displacements),
        **holding._asdict(),
        steps=best.records,
        attempts=attempts,
        tol=robot.settings.tol,
        model=model,
    )


class Holding(NamedTuple):
    """Why no step comes closer to the goals, as in `InverseResult`."""

    active_limits: tuple[str, ...] = ()
    held_by: tuple[str, ...] = ()
    blind: BlindDirection | None = None


def what_holds(robot: Command, end: Evaluation) -> Holding:
    """Split what is left of the errors between limits and blind directions.

    At a minimum, the slope W^T r is balanced by the limits that are reached, W^T r +
    A^T mu = 0 with mu >= 0. A limit holds where its mu is positive. What W does not
    reach at all is blind.
    """
    reached = robot.reached(end)
    active = tuple(_in_words(robot, *limit) for limit, _ in reached)
    off = robot.residuals(end)
    if np.abs(off).max() <= robot.settings.tol:
        return Holding(active)
    r, W = map(np.asarray, end.rows)
    # Gradients by z: at a limit that is reached, gradient @ z must not be positive.
    A = np.array([gradient for _, gradient in reached]).reshape(-1, W.shape[1])
    return Holding(
        active_limits=active,
        held_by=tuple(active[i] for i in strongest_limits(W, r, A)),
        blind=_blind(robot, W[: len(off)], off),
    )


def strongest_limits(
    W: Float[HostArray, "n_e n"],
    r: Float[HostArray, " n_e"],
    A: Float[HostArray, "n_limits n"],
) -> list[int]:
    """Order the limits that hold a minimum of ||W y + r||^2, the strongest first.

    Their gradients A by y balance its slope, W^T r + A^T mu = 0 with mu >= 0; one
    without a share is left out.
    """
    # Here, so that commands which do not need it do not wait for it.
    from scipy.optimize import nnls

    mu = nnls(A.T, -W.T @ r)[0] if len(A) else np.zeros(0)
    # The step that each limit forbids: the cosine between the errors and its effect.
    effect = np.linalg.norm(W @ A.T, axis=0) * np.linalg.norm(r)
    cosine = mu * (A**2).sum(axis=1) / np.where(effect > 0.0, effect, np.inf)
    return [int(i) for i in np.argsort(-cosine) if cosine[i] > HOLDS]


def _blind(
    robot: Command, W: Float[HostArray, "n_e n_a"], off: Float[HostArray, " n_e"]
) -> BlindDirection | None:
    """Find the share of the errors in directions that W hardly reaches."""
    U, sizes, _ = np.linalg.svd(W, full_matrices=False)
    seen = U[:, sizes > BLIND * sizes[0]]
    share = off - seen @ (seen.T @ off)
    if np.abs(share).max() <= robot.settings.tol:
        return None
    direction = share / np.linalg.norm(share)
    gain = np.linalg.norm(direction @ W) / sizes[0] if sizes[0] > 0.0 else 0.0
    weights = np.asarray(robot.problem.configurations.effectors.inverse_std)[0]
    std = 1.0 / np.where(weights > 0.0, weights, np.inf)
    rows, shares = direction.reshape(std.shape), share.reshape(std.shape) * std
    parts = [
        (
            f"{name} of {record.name!r}".removeprefix(" of "),
            record.unit,
            rows[entry],
            shares[entry],
        )
        for record in robot.records
        for k, name in enumerate(coordinate_names(record))
        if record.seen[k] and (entry := (record.index, k))
    ]
    names, units, components, offs = zip(*parts, strict=True)
    return BlindDirection(
        coordinates=names,
        units=units,
        direction=np.array(components),
        off=np.array(offs),
        gain=float(gain),
    )


def _in_words(robot: Command, k: int, kind: int) -> str:
    """Say which limit of an input, or of what follows it, is reached."""
    of_input, side, one = kind < 2, ("lower", "upper")[kind % 2], robot.inputs[k]
    actuators = robot.problem.model.mechanism.actuators
    of_kind, name = actuators.kinds[one.a], actuators.names[one.a]
    moves = one.by_displacement == of_input
    what = "displacement" if moves else of_kind.force
    unit = of_kind.displacement_unit if moves else of_kind.force_unit
    limit = (*one.box, *one.following)[kind]
    if of_input and abs(limit - one.start) >= one.step * (1.0 - 1e-12):
        what, side = f"step of the {what}", "longest"
    value = readable_values([limit], unit or "")
    return f"{what} of {of_kind.noun} {name!r} at its {side} limit, {value}"
