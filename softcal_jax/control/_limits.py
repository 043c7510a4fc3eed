"""Limits of the forces, displacements and steps of actuators."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from softcal_jax._module import Module
from softcal_jax._names import unknown_name
from softcal_jax._typing import Float, HostArray
from softcal_jax.actuators import Kind
from softcal_jax.configurations import Configuration, ImposedDisplacement, Mechanism

ANYTHING = (-np.inf, np.inf)
"""No limits."""


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


class LimitArrays(NamedTuple):
    """Lowest and highest values of what is imposed, the inputs, and of what follows.

    Both limits of an input are equal for an actuator that is not commanded. `step`
    limits the change of an input.
    """

    inputs: Float[HostArray, "2 n_a"]
    following: Float[HostArray, "2 n_a"]
    step: Float[HostArray, " n_a"]


def limit_arrays(
    mechanism: Mechanism, configuration: Configuration, limits: Mapping[str, Limits]
) -> LimitArrays:
    actuators, actuation = mechanism.actuators, configuration.actuation
    for name in limits:
        if name not in actuators.names:
            raise unknown_name("actuator with limits", name, actuators.names)
        if name not in actuation:
            raise ValueError(
                f"actuator {name!r} has limits, but is not commanded: give it a start "
                f"in the `actuation` of configuration {configuration.name!r}."
            )
    n_a = len(actuators.names)
    inputs, following = np.zeros((2, n_a)), np.repeat(np.array([ANYTHING]).T, n_a, 1)
    step = np.full(n_a, np.inf)
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
        step[a] = given.step
        by_displacement = isinstance(asked, ImposedDisplacement)
        quantity = "displacement" if by_displacement else "force"
        both = (displacement, force) if by_displacement else (force, displacement)
        inputs[:, a], following[:, a] = both
        (lower, upper), unit = inputs[:, a], getattr(kind, f"{quantity}_unit")
        if not lower <= asked.value <= upper:
            raise ValueError(
                f"{what} starts outside its limits: its {quantity} is {asked.value:g} "
                f"{unit} in `actuation`, the limits are {lower:g} to {upper:g} {unit}. "
                "Start inside them, or widen them."
            )
    return LimitArrays(inputs, following, step)


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
