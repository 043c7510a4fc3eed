"""Limits of the forces, displacements and steps of actuators."""

from collections.abc import Mapping

import equinox as eqx
import numpy as np

from softcal_jax._names import unknown_name
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.actuators import Kind
from softcal_jax.configurations import Configuration, ImposedDisplacement, Mechanism

ANYTHING = (-np.inf, np.inf)
"""No limits."""


class Limits(eqx.Module):
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


class LimitArrays(eqx.Module):
    """Limits of all actuators, on the imposed quantity (the input) and the other one.

    Attributes:
        lower: Lowest inputs; equal to `upper` for actuators that are not commanded.
        upper: Highest inputs.
        step: Largest change of each input in one command.
        follow_lower: Lowest displacement where the force is imposed, and lowest force
            where the displacement is.
        follow_upper: Highest one, likewise.
    """

    lower: Float[Array | HostArray, " n_a"]
    upper: Float[Array | HostArray, " n_a"]
    step: Float[Array | HostArray, " n_a"]
    follow_lower: Float[Array | HostArray, " n_a"]
    follow_upper: Float[Array | HostArray, " n_a"]


def limit_arrays(
    mechanism: Mechanism, configuration: Configuration, limits: Mapping[str, Limits]
) -> LimitArrays:
    """Convert limits by name to arrays over all actuators.

    Args:
        mechanism: The actuators of the model.
        configuration: Its `actuation` names the commanded actuators and their start.
        limits: Limits by the names of actuators.

    Raises:
        ValueError: If an actuator is unknown or not commanded, lacks the limited
            quantity or starts outside its limits, or a lower limit exceeds the upper.
    """
    actuators = mechanism.actuators
    actuation, n_a = configuration.actuation, len(actuators.names)
    what = f"configuration {configuration.name!r}"
    for name in limits:
        if name not in actuators.names:
            raise unknown_name("actuator with limits", name, actuators.names)
        if name not in actuation:
            raise ValueError(
                f"actuator {name!r} has limits, but {what} asks nothing of it, so it "
                "is not commanded: give it a start in `actuation`."
            )
    held = np.zeros((2, n_a))
    free = np.full((2, n_a), np.inf) * np.array([[-1.0], [1.0]])
    step = np.full(n_a, np.inf)
    for name, asked in actuation.items():
        a = actuators.names.index(name)
        kind = actuators.kinds[a]
        given = limits.get(name, Limits())
        force = _range(kind, name, "force", given.force, kind.force_unit)
        displacement = _range(
            kind, name, "displacement", given.displacement, kind.displacement_unit
        )
        if actuators.motor_body[a] >= 0:
            displacement = np.clip(displacement, -np.pi, np.pi)
        if not given.step >= 0.0:
            raise ValueError(
                f"{kind.noun} {name!r}: step must not be negative, got {given.step:g}."
            )
        imposed = isinstance(asked, ImposedDisplacement)
        held[:, a], free[:, a] = (
            (displacement, force) if imposed else (force, displacement)
        )
        step[a] = given.step
        _check_start(kind, name, imposed, asked.value, held[:, a])
    return LimitArrays(
        lower=held[0],
        upper=held[1],
        step=step,
        follow_lower=free[0],
        follow_upper=free[1],
    )


def _range(kind: Kind, name: str, what: str, given, unit: str | None) -> HostArray:
    """Check the lower and upper limit of a quantity and return them."""
    lower, upper = given
    if unit is None:
        if (lower, upper) != ANYTHING:
            raise ValueError(f"{kind.noun} {name!r} has no {what} to be limited.")
        return np.array(ANYTHING)
    pushes = what == "force" and kind.unilateral
    least = max(lower, 0.0) if pushes else lower
    if not least <= upper:
        only_pulls = ", and it only pulls" if pushes else ""
        raise ValueError(
            f"limits of the {what} of {kind.noun} {name!r} clash: lower {lower:g} "
            f"{unit}, upper {upper:g} {unit}{only_pulls}."
        )
    return np.array([least, upper])


def _check_start(kind: Kind, name: str, imposed: bool, start: float, limits) -> None:
    what = "displacement" if imposed else "force"
    unit = kind.displacement_unit if imposed else kind.force_unit
    if not limits[0] <= start <= limits[1]:
        raise ValueError(
            f"{kind.noun} {name!r} starts outside its limits: its {what} is {start:g} "
            f"{unit} in `actuation`, the limits are {limits[0]:g} to {limits[1]:g} "
            f"{unit}. Start inside them, or widen them."
        )


def active_limits(
    mechanism: Mechanism,
    by_displacement: Bool[HostArray, " n_a"],
    active: Bool[HostArray, "4 n_a"],
    step_reached: Bool[HostArray, " n_a"],
) -> tuple[str, ...]:
    """Name the active limits in words.

    Args:
        mechanism: The actuators.
        by_displacement: Where the displacement is imposed.
        active: Whether a limit is active: rows are lower and upper limit of the input,
            then of the other quantity.
        step_reached: Where the limit on the step of an input is the active one.
    """
    found = []
    for a, name in enumerate(mechanism.actuators.names):
        for row, side in enumerate(("lower", "upper", "lower", "upper")):
            if not active[row, a]:
                continue
            of_input = row < 2
            displacement = bool(by_displacement[a]) == of_input
            what = "displacement" if displacement else "force"
            if of_input and step_reached[a]:
                what, side = f"step of the {what}", "longest"
            noun = mechanism.actuators.kinds[a].noun
            found.append(f"{what} of {noun} {name!r} at its {side} limit")
    return tuple(found)
