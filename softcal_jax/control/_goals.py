"""Goals of effectors: their measured values, or values given by name."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._names import unknown_name
from softcal_jax._typing import Float, HostArray
from softcal_jax.bodies import Pose
from softcal_jax.configurations import (
    AbstractEffector,
    AbstractScalar,
    BodyFrame,
    Configuration,
    ConfigurationLanes,
    Observation,
)

Goal = Pose | Float[ArrayLike, "3"] | Sequence[float] | float
"""A pose from rest for a `BodyFrame`, three numbers for a point or a reaction, one
number for a length, volume, angle or force; in SI units and radians."""


def with_goals(configuration: Configuration, goals: Mapping[str, Goal]):
    """Replace the measured values of a configuration by goals.

    Effectors without a goal keep their values.

    Raises:
        ValueError: If a name is unknown, a goal has the wrong number of coordinates, or
            some but not all markers of a configuration have one.
    """
    markers = configuration.markers
    marker_names = () if markers is None else markers.names
    known = [*(effector.name for effector in configuration.effectors), *marker_names]
    for name in goals:
        if name not in known:
            what = f"effector of configuration {configuration.name!r}"
            raise unknown_name(what, name, known)
    effectors = tuple(
        _aimed(effector, goals[effector.name]) if effector.name in goals else effector
        for effector in configuration.effectors
    )
    measured = configuration.measured
    missing = [name for name in marker_names if name not in goals]
    if len(missing) < len(marker_names):
        if measured is None and missing:
            raise ValueError(
                f"marker {missing[0]!r} of configuration {configuration.name!r} has no "
                "goal, but others have: give one to each, or leave it out."
            )
        measured = np.zeros((len(marker_names), 3)) if measured is None else measured
        measured = measured.copy()
        for row, name in enumerate(marker_names):
            if name in goals:
                measured[row] = _numbers(f"marker {name!r}", goals[name], 3)
    return replace(configuration, effectors=effectors, measured=measured)


def _aimed(effector: AbstractEffector, goal: Goal) -> AbstractEffector:
    what = f"effector {effector.name!r}"
    if isinstance(effector, BodyFrame):
        if not isinstance(goal, Pose):
            raise ValueError(
                f"the goal of {what} is {goal!r}, expected a Pose, of 6 coordinates."
            )
        return replace(effector, measured=goal)
    if isinstance(effector, AbstractScalar):
        return replace(effector, measured=float(_numbers(what, goal, 1)[0]))
    n = effector.n_values if isinstance(effector, Observation) else 3
    numbers = _numbers(what, goal, n)
    value = numbers if n > 1 else float(numbers[0])
    return replace(effector, measured=value)  # type: ignore[call-arg]


def _numbers(what: str, goal: Goal, count: int) -> Float[HostArray, " n"]:
    if isinstance(goal, Pose):
        raise ValueError(
            f"the goal of {what} is a Pose of 6 coordinates, expected {count} "
            f"number{'s' * (count > 1)}."
        )
    numbers = np.atleast_1d(np.asarray(goal, float))
    if numbers.shape != (count,):
        raise ValueError(
            f"the goal of {what} has {numbers.size} numbers, expected {count}."
        )
    return numbers


def goal_weights(lanes: ConfigurationLanes, name: str) -> Float[HostArray, "n_rows 3"]:
    """Return 1 / standard deviation of all coordinates, 0 for those without a goal."""
    (records,) = lanes.effectors
    inverse_std = np.asarray(lanes.arrays.effectors.inverse_std)[0]
    if not inverse_std.any():
        names = dict.fromkeys(record.name for record in records)
        listed = ", ".join(map(repr, names)) or "none"
        raise ValueError(
            f"no effector of configuration {name!r} has a goal: give measured values, "
            f"or `goals` by name. Effectors: {listed}."
        )
    return inverse_std
