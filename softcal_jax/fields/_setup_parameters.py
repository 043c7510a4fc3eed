"""Constructors of parameters of setup, loads and recordings."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Float
from softcal_jax.fields._parameters import Parameter
from softcal_jax.fields._setup import XYZ, Scope, SetupParameter


class Knowledge(NamedTuple):
    """Prior knowledge of a quantity.

    Attributes:
        nominal: Nominal value, in SI units.
        limit: Largest error considered, in SI units; on a log scale a factor.
        prior_std: Standard deviation of the error, in SI units or, on a log scale,
            relative; None if it is not known.
        least: Smallest value that it can have at all, in SI units.
    """

    nominal: float
    limit: float
    prior_std: float | None
    least: float = -np.inf


def setup_parameters(
    kind: str,
    of: str = "",
    *,
    name: str,
    knowledge: Knowledge,
    unit: str = "",
    scale: Literal["linear", "log"] = "linear",
    axis: str = "",
    each: Sequence[str] = (),
    by: Scope = "recording",
) -> SetupParameter:
    """Make the entry for one array entry of the setup.

    Args:
        kind: One of `QUANTITIES`.
        of: What it belongs to, like the motor.
        name: Name of the unknown; with `each`, " in ..." is added.
        knowledge: Nominal value, limit and prior.
        unit: SI unit, for tables.
        scale: "linear", or "log" for a factor or a stiffness.
        axis: Component of a quantity that has several.
        each: Configurations or recordings with an unknown each; one for all by default.
        by: What `each` names.

    Raises:
        ValueError: If the arguments are inconsistent.
    """
    nominal, limit, prior_std, least = knowledge
    log = scale == "log"
    lower, upper = (
        (nominal / limit, nominal * limit)
        if log
        else (nominal - limit, nominal + limit)
    )
    names = [f"{name} in {member}" for member in each] or [name]
    own = [
        Parameter(
            own_name,
            field="",
            start=nominal,
            lower=max(least, lower),
            upper=upper,
            scale=scale,
            S=None if log else limit,
            unit=unit,
            prior_std=prior_std,
        )
        for own_name in names
    ]
    return SetupParameter(kind, of, own, axis, each, by)


def motor_zero(motor: str, *, limit: float, prior_std: float | None) -> SetupParameter:
    """Make the zero error of a motor a parameter.

    Args:
        motor: Name of the motor.
        limit: Largest error considered [rad].
        prior_std: Prior standard deviation [rad]; None if not known.
    """
    return setup_parameters(
        "motor_zero",
        motor,
        name=f"zero of {motor}",
        knowledge=Knowledge(0.0, limit, prior_std),
        unit="rad",
    )


def mounting(
    body: str,
    nominal: Float[ArrayLike, "3"] | Sequence[float],
    *,
    limit: float,
    prior_std: float | None,
) -> tuple[SetupParameter, ...]:
    """Make the three coordinates of the mounting of a rigid body parameters.

    Args:
        body: Name of the body.
        nominal: Nominal translation [m].
        limit: Largest error considered, per axis [m].
        prior_std: Prior standard deviation [m]; None if not known.
    """
    return tuple(
        setup_parameters(
            "mounting",
            body,
            name=f"mounting {axis} of {body}",
            knowledge=Knowledge(float(value), limit, prior_std),
            unit="m",
            axis=axis,
        )
        for axis, value in zip(XYZ, np.asarray(nominal), strict=True)
    )


def friction(
    actuator: str, nominal: float, *, limit: float, prior_std: float | None
) -> SetupParameter:
    """Make the coefficient of friction of a cable a parameter.

    Args:
        actuator: Name of a cable with friction.
        nominal: Nominal coefficient [-].
        limit: Largest error considered; it stays above zero [-].
        prior_std: Prior standard deviation; None if not known [-].
    """
    return setup_parameters(
        "friction",
        actuator,
        name=f"friction of {actuator}",
        knowledge=Knowledge(nominal, limit, prior_std, least=0.0),
    )


def gravity_tilt(
    *,
    limit: float = float(np.deg2rad(10.0)),
    prior_std: float | None,
    each: Sequence[str] = (),
    by: Scope = "recording",
) -> tuple[SetupParameter, ...]:
    """Make the direction of gravity two parameters: angles about two axes normal to it.

    The axes are defined in `ConfigurationArrays.acceleration`.

    Args:
        limit: Largest tilt considered, per axis [rad].
        prior_std: Prior standard deviation [rad]; None if not known.
        each: Configurations or recordings with a tilt each; one for all by default.
        by: What `each` names.
    """
    return tuple(
        setup_parameters(
            "gravity_tilt",
            name=f"{axis} tilt of gravity",
            knowledge=Knowledge(0.0, limit, prior_std),
            unit="rad",
            axis=axis,
            each=each,
            by=by,
        )
        for axis in ("first", "second")
    )


def load_factor(
    *,
    limit: float = 2.0,
    prior_std: float | None,
    each: Sequence[str] = (),
    by: Scope = "recording",
) -> SetupParameter:
    """Make a factor on the dead loads a parameter, for forces known to some percent.

    Args:
        limit: Largest factor considered, and 1 over the smallest [-].
        prior_std: Relative standard deviation of the forces, like 0.05; None if not
            known [-].
        each: Configurations or recordings with a factor each; one for all by default.
        by: What `each` names.
    """
    return setup_parameters(
        "load_factor",
        name="factor of loads",
        knowledge=Knowledge(1.0, limit, prior_std),
        scale="log",
        each=each,
        by=by,
    )


def actuator_factor(
    actuator: str,
    *,
    limit: float = 2.0,
    prior_std: float | None,
    each: Sequence[str] = (),
    by: Scope = "recording",
) -> SetupParameter:
    """Make a factor on the imposed force of an actuator a parameter.

    Args:
        actuator: Name of the actuator.
        limit: Largest factor considered, and 1 over the smallest [-].
        prior_std: Relative standard deviation of the force, like 0.05; None if not
            known [-].
        each: Configurations or recordings with a factor each; one for all by default.
        by: What `each` names.
    """
    return setup_parameters(
        "actuator_factor",
        actuator,
        name=f"factor of {actuator}",
        knowledge=Knowledge(1.0, limit, prior_std),
        scale="log",
        each=each,
        by=by,
    )


def recording_offset(
    *,
    limit: float,
    prior_std: float | None,
    turn_limit: float | None = None,
    turn_prior_std: float | None = None,
    each: Sequence[str] = (),
    by: Scope = "recording",
) -> tuple[SetupParameter, ...]:
    """Make the frame of a recording, or of a tracker's base, parameters.

    These are three coordinates of its offset and, with `turn_limit`, three of its
    rotation; see `RecordingBase`.

    Args:
        limit: Largest offset considered, per axis [m].
        prior_std: Prior standard deviation [m]; None if not known.
        turn_limit: Largest rotation considered, per axis [rad]; none by default.
        turn_prior_std: Prior standard deviation [rad]; None if not known.
        each: Configurations or recordings with a frame each; one for all by default.
        by: What `each` names.
    """
    kinds = [("recording_offset", "offset", "m", Knowledge(0.0, limit, prior_std))]
    if turn_limit is not None:
        turned = Knowledge(0.0, turn_limit, turn_prior_std)
        kinds.append(("recording_turn", "turn", "rad", turned))
    return tuple(
        setup_parameters(
            kind,
            name=f"{noun} {axis}",
            knowledge=knowledge,
            unit=unit,
            axis=axis,
            each=each,
            by=by,
        )
        for kind, noun, unit, knowledge in kinds
        for axis in XYZ
    )


def clamp_stiffness(
    group: str,
    nominal: float,
    *,
    limit: float = 1e3,
    prior_std: float | None,
    each: Sequence[str] = (),
    by: Scope = "recording",
) -> SetupParameter:
    """Make the stiffness of an elastic support a parameter.

    Args:
        group: Surface group of a `Support` with a stiffness.
        nominal: Nominal stiffness [N/m3].
        limit: Largest ratio to it considered, and 1 over the smallest [-].
        prior_std: Relative prior standard deviation; None if not known [-].
        each: Configurations or recordings with a stiffness each; by default one
            for all.
        by: What `each` names.
    """
    return setup_parameters(
        "clamp_stiffness",
        group,
        name=f"stiffness of {group}",
        knowledge=Knowledge(nominal, limit, prior_std),
        unit="N/m^3",
        scale="log",
        each=each,
        by=by,
    )
