"""Errors of the setup as parameters: zeros of motors, places of mountings."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._names import unknown_name
from softcal_jax._typing import Array, Float
from softcal_jax.fields._parameters import Parameter


class SetupParameter(eqx.Module):
    """One unknown of how the robot was set up, calibrated together with its material.

    The paper asks for this decoupling in Sec. VII: an error of the setup that is no
    parameter ends up in the moduli.

    Attributes:
        kind: "motor_zero", what a motor adds to its angle [rad]; or "mounting", a
            coordinate of the translation that mounts a rigid body [m].
        of: The motor, or the rigid body.
        parameter: Name, start, bounds, scaling and prior; of a linear scale. Its
            `field` is not looked at.
        axis: Coordinate of a mounting, "x", "y" or "z".
    """

    kind: str = eqx.field(static=True)
    of: str = eqx.field(static=True)
    parameter: Parameter
    axis: str = eqx.field(static=True, default="x")

    def __check_init__(self):
        if self.kind not in ("motor_zero", "mounting"):
            raise ValueError(
                f'kind must be "motor_zero" or "mounting", got {self.kind!r}.'
            )
        if self.axis not in ("x", "y", "z"):
            raise ValueError(f'axis must be "x", "y" or "z", got {self.axis!r}.')
        if self.parameter.scale != "linear":
            raise ValueError(
                f"parameter {self.parameter.name!r} of the setup needs "
                'scale="linear": zero is a value that it may have.'
            )

    @property
    def field(self) -> str:
        """What it sets, for messages."""
        return self.kind

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknown that it adds."""
        return (self.parameter,)

    def check(self, model: Any) -> None:
        """Raise ValueError unless the model has the motor or the body."""
        mechanism = model.mechanism
        if self.kind == "mounting":
            known, kind = mechanism.bodies.names, "rigid body"
        else:
            actuators = mechanism.actuators
            motors = zip(actuators.names, actuators.motor_body, strict=True)
            known, kind = [name for name, body in motors if body >= 0], "motor"
        if self.of not in known:
            what = f"{kind} of parameter {self.parameter.name!r}"
            raise unknown_name(what, self.of, known)

    def apply(self, model: Any, values: Mapping[str, Float[Array, ""]]) -> Any:
        """The model with the value of this parameter, out of those of all."""
        value, mechanism = values[self.parameter.name], model.mechanism
        if self.kind == "motor_zero":
            a = mechanism.actuators.names.index(self.of)
            zeros = mechanism.motor_zero.at[a].set(value)
            return eqx.tree_at(lambda m: m.mechanism.motor_zero, model, zeros)
        k = mechanism.bodies.names.index(self.of)
        moved = mechanism.bodies.mounting_translation.at[k, "xyz".index(self.axis)]
        return eqx.tree_at(
            lambda m: m.mechanism.bodies.mounting_translation, model, moved.set(value)
        )


def motor_zero(motor: str, *, limit: float, prior_std: float | None) -> SetupParameter:
    """The zero error of a motor as a parameter.

    Args:
        motor: Name of the motor.
        limit: Largest error looked for [rad].
        prior_std: Its standard deviation before any data [rad]; None if not known.
    """
    what = f"zero of {motor}"
    parameter = Parameter(
        what,
        "motor_zero",
        0.0,
        -limit,
        limit,
        scale="linear",
        S=limit,
        unit="rad",
        prior_std=prior_std,
    )
    return SetupParameter("motor_zero", motor, parameter)


def mounting(
    body: str,
    nominal: Float[ArrayLike, "3"] | Sequence[float],
    *,
    limit: float,
    prior_std: float | None,
) -> tuple[SetupParameter, ...]:
    """The three coordinates of the mounting of a rigid body as parameters.

    Args:
        body: Name of the body.
        nominal: Translation that it should have [m].
        limit: Largest error looked for, per axis [m].
        prior_std: Its standard deviation before any data [m]; None if not known.
    """
    return tuple(
        SetupParameter(
            "mounting",
            body,
            Parameter(
                f"mounting {axis} of {body}",
                "mounting",
                float(value),
                float(value) - limit,
                float(value) + limit,
                scale="linear",
                S=limit,
                unit="m",
                prior_std=prior_std,
            ),
            axis,
        )
        for axis, value in zip(("x", "y", "z"), np.asarray(nominal), strict=True)
    )
