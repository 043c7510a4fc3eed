"""Goals of effectors, by their measured values or by name, and limits of actuators."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._module import Module
from softcal_jax._text import check_known, listed, parse_axes
from softcal_jax._typing import Float, HostArray
from softcal_jax.actuators import Kind
from softcal_jax.bodies import Pose
from softcal_jax.configurations import (
    AbstractEffector,
    BodyFrame,
    Configuration,
    ImposedDisplacement,
    Mechanism,
)

Goal = Pose | Float[ArrayLike, "3"] | Sequence[float] | float
"""What an effector is to reach, see `solve_inverse`."""

ANYTHING = (-np.inf, np.inf)  # no limits


def with_goals(configuration: Configuration, goals: Mapping[str, Goal]):
    """Give a configuration goals, and no others: what it measured is no goal.

    A marker may leave coordinates free, by nan.

    Raises:
        ValueError: If a name is unknown, a goal has the wrong number of coordinates, or
            markers leave different coordinates free.
    """
    markers = configuration.markers
    names = () if markers is None else markers.names
    axes = np.isin(range(3), parse_axes(markers.axes if markers else "xyz"))
    known = [*(effector.name for effector in configuration.effectors), *names]
    check_known(f"effector of configuration {configuration.name!r}", known, *goals)
    free = lambda effector: replace(effector, measured=None)
    effectors = tuple(
        _aimed(e, goals[e.name]) if e.name in goals else free(e)
        for e in configuration.effectors
    )
    places = {
        name: np.where(axes, _numbers(f"marker {name!r}", goal, 3), np.nan)
        for name, goal in goals.items()
        if name in names
    }
    return replace(with_marker_goals(configuration, places), effectors=effectors)


def with_marker_goals(
    configuration: Configuration, places: Mapping[str, Float[HostArray, "3"]]
) -> Configuration:
    """Keep the markers with a goal [m], and the axes along which it is not nan."""
    markers = configuration.markers
    if markers is None or not places:
        return replace(configuration, markers=None, measured=None)
    goals = np.array([*places.values()])
    asked = np.isfinite(goals)
    for name, goal in places.items():
        if not np.isfinite(goal).any():
            raise ValueError(f"the goal of {name!r} leaves every coordinate free.")
    if (asked != asked[0]).any():
        raise ValueError(
            f"the goals of {listed([repr(name) for name in places])} leave different "
            "coordinates free; expected the same of all markers."
        )
    rows = [markers.names.index(name) for name in places]
    std, rest = np.asarray(markers.std), markers.positions[rows]
    kept = replace(
        markers,
        names=tuple(places),
        positions=rest,
        std=markers.std if std.ndim == 0 else std[rows],
        axes="".join(compress("xyz", asked[0])),
    )
    return replace(configuration, markers=kept, measured=np.where(asked, goals, rest))


def _aimed(effector: AbstractEffector, goal: Goal) -> AbstractEffector:
    what = f"effector {effector.name!r}"
    if isinstance(effector, BodyFrame):
        if not isinstance(goal, Pose):
            raise ValueError(
                f"the goal of {what} is {goal!r}, expected a Pose, of 6 coordinates."
            )
        return replace(effector, measured=goal)
    numbers = _numbers(what, goal, effector.n_values)
    if not np.isfinite(numbers).all():
        few = {1: "a finite number", 2: "two finite numbers", 3: "three finite numbers"}
        raise ValueError(
            f"the goal of {what} is {numbers}, expected "
            f"{few.get(numbers.size, 'finite numbers')}; only markers may leave "
            "coordinates free (nan)."
        )
    value = numbers if numbers.size > 1 else float(numbers[0])
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


class Limits(Module):
    """Limits of one actuator, whether its force or its displacement is imposed.

    Regardless of them, a cable never pushes and a motor stays within half a turn.

    Attributes:
        force: Lowest and highest lambda_a, in the unit of the actuator.
        displacement: Lowest and highest delta_a, in the unit of the actuator.
        step: Largest change of the imposed quantity within one command, that is, from
            one goal of a trajectory to the next.
    """

    force: tuple[float, float] = ANYTHING
    displacement: tuple[float, float] = ANYTHING
    step: float = np.inf


class Input(NamedTuple):
    """An actuator that is commanded, in its unit.

    Attributes:
        a: Its index.
        by_displacement: Whether its displacement is imposed, else its force.
        start: The imposed value at which it starts.
        imposed: Lowest and highest value of that.
        following: Lowest and highest value of what is not imposed and follows.
        step: Largest change of the imposed value within one command.
    """

    a: int
    by_displacement: bool
    start: float
    imposed: tuple[float, float]
    following: tuple[float, float]
    step: float

    @property
    def box(self) -> tuple[float, float]:
        """Lowest and highest imposed value, the longest step included."""
        (lower, upper), start, step = self.imposed, self.start, self.step
        return max(lower, start - step), min(upper, start + step)


def commanded(
    mechanism: Mechanism, configuration: Configuration, limits: Mapping[str, Limits]
) -> list[Input]:
    """Return the actuators in the actuation of a configuration, with their limits."""
    actuators, actuation = mechanism.actuators, configuration.actuation
    check_known("actuator with limits", actuators.names, *limits)
    for name in limits:
        if name not in actuation:
            raise ValueError(
                f"actuator {name!r} has limits, but is not commanded: give it a start "
                f"in the `actuation` of configuration {configuration.name!r}."
            )
    inputs = []
    for name, asked in actuation.items():
        a = actuators.names.index(name)
        kind, given = actuators.kinds[a], limits.get(name, Limits())
        what = f"{kind.noun} {name!r}"
        force = _range(kind, what, "force", given.force)
        displacement = _range(kind, what, "displacement", given.displacement)
        if actuators.motor_body[a] >= 0:
            displacement = np.clip(displacement, -np.pi, np.pi)
        if not given.step >= 0.0:
            raise ValueError(f"{what}: step must not be negative, got {given.step:g}.")
        by_displacement = isinstance(asked, ImposedDisplacement)
        quantity = "displacement" if by_displacement else "force"
        both = (displacement, force) if by_displacement else (force, displacement)
        (lower, upper), (least, most) = (map(float, pair) for pair in both)
        unit = getattr(kind, f"{quantity}_unit")
        noun = kind.force if quantity == "force" else quantity
        if not lower <= asked.value <= upper:
            raise ValueError(
                f"{what} starts outside its limits: its {noun} is {asked.value:g} "
                f"{unit} in `actuation`, the limits are {lower:g} to {upper:g} {unit}. "
                "Start inside them, or widen them."
            )
        start, step = float(asked.value), float(given.step)
        ends = (lower, upper), (least, most)
        inputs.append(Input(a, by_displacement, start, *ends, step))
    return inputs


def _range(kind: Kind, what: str, quantity: str, given) -> Float[HostArray, "2"]:
    lower, upper = given
    unit = getattr(kind, f"{quantity}_unit")
    if unit is None:
        if (lower, upper) != ANYTHING:
            raise ValueError(f"{what} has no {quantity} to be limited.")
        return np.array(ANYTHING)
    pulls = quantity == "force" and kind.unilateral
    least = max(lower, 0.0) if pulls else lower
    if not least <= upper:
        raise ValueError(
            f"limits of the {quantity} of {what} clash: lower {lower:g} {unit}, upper "
            f"{upper:g} {unit}{', and it only pulls' * pulls}."
        )
    return np.array([least, upper], float)
