"""The kinds of parameters of setup, loads and recordings, each with its constructor.

To add a kind, declare here what it sets and where it can occur, write the function
that makes parameters of it, and export that. `project._setup` has a table for each, and
`Uncertain` a standard deviation for those that count where they are not fitted.
"""

from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._names import UNNAMED_LOADS
from softcal_jax._typing import Float
from softcal_jax.fields._occurrence import (
    driven_by_angle,
    of_recordings,
    with_forces,
    with_gravity,
    with_loads,
    with_mounting,
    with_springs,
)
from softcal_jax.fields._parameters import Parameter
from softcal_jax.fields._setup import (
    QUANTITIES,
    By,
    Change,
    Quantity,
    SetupParameter,
    entry_of,
)

_XYZ = ("x", "y", "z")
_FACTOR = ("log", "linear")


def _unknowns(
    kind: str,
    of: str = "",
    *,
    limit: float,
    prior_std: float | None,
    nominal: Float[ArrayLike, "..."] | Sequence[float] | None = None,
    each: Sequence[str] = (),
    by: By = "recording",
) -> tuple[SetupParameter, ...]:
    """Make the entries of a quantity, one per component.

    `limit` is the largest error, in SI units, or factor on a log scale. `nominal` is 0,
    or 1 for a factor.
    """
    quantity = QUANTITIES[kind]
    axes, scale = quantity.components or ("",), quantity.scales[0]
    log = scale == "log"
    middles = np.broadcast_to(float(log) if nominal is None else nominal, len(axes))
    entries = []
    for axis, middle in zip(axes, middles, strict=True):
        name = quantity.title.format(of=of, axis=axis)
        unknowns = [
            Parameter(
                own_name,
                field="",
                start=middle,
                lower=max(quantity.least, middle / limit if log else middle - limit),
                upper=middle * limit if log else middle + limit,
                scale=scale,
                S=None if log else limit,
                unit=quantity.unit,
                prior_std=prior_std,
            )
            for own_name in [f"{name} in {member}" for member in each] or [name]
        ]
        entries.append(SetupParameter(kind, of, unknowns, axis, each, by))
    return tuple(entries)


def _actuators(which: Callable[[Any], list[bool]]) -> Callable[[Any], list[str]]:
    """Make the function that names all actuators, those not of a kind empty."""

    def names(model: Any) -> list[str]:
        actuators = model.mechanism.actuators
        both = zip(actuators.names, which(actuators), strict=True)
        return [name if known else "" for name, known in both]

    return names


QUANTITIES["motor_zero"] = Quantity(
    "zero of {of}",
    entry_of("mechanism.motor_zero"),
    noun="motor",
    names=_actuators(lambda a: [body >= 0 for body in a.motor_body]),
    unit="rad",
    uncertain="zeros",
    role="considered",
    occurs=driven_by_angle,
)


def motor_zero(motor: str, *, limit: float, prior_std: float | None) -> SetupParameter:
    """Make the zero error of a motor a parameter.

    Args:
        motor: Name of the motor.
        limit: Largest error considered [rad].
        prior_std: Prior standard deviation [rad]; None if not known.
    """
    return _unknowns("motor_zero", motor, limit=limit, prior_std=prior_std)[0]


QUANTITIES["mounting"] = Quantity(
    "mounting {axis} of {of}",
    entry_of("mechanism.bodies.mounting_translation"),
    noun="rigid body",
    names=attrgetter("mechanism.bodies.names"),
    components=_XYZ,
    unit="m",
    uncertain="mountings",
    role="considered",
    occurs=with_mounting,
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
    return _unknowns(
        "mounting", body, limit=limit, prior_std=prior_std, nominal=nominal
    )


def _put_friction(model: Any, index: tuple[int, ...], change: Change) -> Any:
    # One for all configurations, so that the old one is not asked for.
    actuators = model.mechanism.actuators.with_friction(*index, change(None))
    return eqx.tree_at(lambda m: m.mechanism.actuators, model, actuators)


QUANTITIES["friction"] = Quantity(
    "friction of {of}",
    _put_friction,
    noun="actuator with friction",
    names=_actuators(attrgetter("has_friction")),
    least=0.0,
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
    return _unknowns(
        "friction", actuator, limit=limit, prior_std=prior_std, nominal=nominal
    )[0]


QUANTITIES["gravity_tilt"] = Quantity(
    "{axis} tilt of gravity",
    entry_of("tilt"),
    components=("first", "second"),
    unit="rad",
    of_configuration=True,
    uncertain="gravity",
    role="considered",
    occurs=with_gravity,
    absent="no configuration has gravity",
)


def gravity_tilt(
    *,
    limit: float = float(np.deg2rad(10.0)),
    prior_std: float | None,
    each: Sequence[str] = (),
    by: By = "recording",
) -> tuple[SetupParameter, ...]:
    """Make the direction of gravity two parameters: angles about two axes normal to it.

    The axes are defined in `ConfigurationArrays.acceleration`.

    Args:
        limit: Largest tilt considered, per axis [rad].
        prior_std: Prior standard deviation; None if not known [rad].
        each: Configurations or recordings with a tilt each; one for all by default.
        by: What `each` names.
    """
    return _unknowns("gravity_tilt", limit=limit, prior_std=prior_std, each=each, by=by)


QUANTITIES["load_factor"] = Quantity(
    "factor of {of}",
    entry_of("loads.factor"),
    noun="load",
    names=attrgetter("loads.names"),
    scales=_FACTOR,
    of_configuration=True,
    uncertain="loads",
    role="considered",
    occurs=with_loads,
    absent="no configuration has such a dead load",
)


def load_factor(
    load: str = UNNAMED_LOADS,
    *,
    limit: float = 2.0,
    prior_std: float | None,
    each: Sequence[str] = (),
    by: By = "recording",
) -> SetupParameter:
    """Make a factor on dead loads a parameter, for forces known to some percent.

    Args:
        load: Name of the loads; by default those without a name of their own.
        limit: Largest factor considered, and 1 over the smallest [-].
        prior_std: Relative prior standard deviation, like 0.05; None if not known [-].
        each: Configurations or recordings with a factor each; one for all by default.
        by: What `each` names.
    """
    (factor,) = _unknowns(
        "load_factor", load, limit=limit, prior_std=prior_std, each=each, by=by
    )
    return factor


QUANTITIES["actuator_factor"] = Quantity(
    "factor of {of}",
    entry_of("actuation.force_factor"),
    noun="actuator",
    names=attrgetter("actuation.names"),
    scales=_FACTOR,
    of_configuration=True,
    uncertain="actuators",
    role="considered",
    occurs=with_forces,
    absent="no configuration imposes a force on {of!r}",
)


def actuator_factor(
    actuator: str,
    *,
    limit: float = 2.0,
    prior_std: float | None,
    each: Sequence[str] = (),
    by: By = "recording",
) -> SetupParameter:
    """Make a factor on the imposed force of an actuator a parameter.

    Args:
        actuator: Name of the actuator.
        limit: Largest factor considered, and 1 over the smallest [-].
        prior_std: Relative prior standard deviation, like 0.05; None if not known [-].
        each: Configurations or recordings with a factor each; one for all by default.
        by: What `each` names.
    """
    return _unknowns(
        "actuator_factor", actuator, limit=limit, prior_std=prior_std, each=each, by=by
    )[0]


QUANTITIES["recording_offset"] = Quantity(
    "offset {axis}",
    entry_of("effectors.base.translation"),
    components=_XYZ,
    unit="m",
    of_configuration=True,
    uncertain="recordings",
    role="noise",
    occurs=of_recordings,
)
QUANTITIES["recording_turn"] = Quantity(
    "turn {axis}",
    entry_of("effectors.base.rotation"),
    components=_XYZ,
    unit="rad",
    of_configuration=True,
    uncertain="gravity",  # a tracker's base is levelled as well as the robot
)


def recording_offset(
    *,
    limit: float | None = None,
    prior_std: float | None = None,
    turn_limit: float | None = None,
    turn_prior_std: float | None = None,
    each: Sequence[str] = (),
    by: By = "recording",
) -> tuple[SetupParameter, ...]:
    """Make the frame of a recording, or of a tracker's base, parameters.

    These are three coordinates of its offset, with `limit`, and three of its rotation,
    with `turn_limit`; see `RecordingBase`.

    Args:
        limit: Largest offset considered, per axis [m]; none by default, as for motions,
            in which it cancels.
        prior_std: Prior standard deviation; None if not known [m].
        turn_limit: Largest rotation considered, per axis [rad]; none by default.
        turn_prior_std: Prior standard deviation [rad]; None if not known.
        each: Configurations or recordings with a frame each; one for all by default.
        by: What `each` names.

    Raises:
        ValueError: If neither limit is given.
    """
    if limit is None and turn_limit is None:
        raise ValueError(
            "a recording_offset needs limit, for its offset, turn_limit, for its "
            "rotation, or both."
        )
    unknowns = partial(_unknowns, each=each, by=by)
    made: tuple[SetupParameter, ...] = ()
    if limit is not None:
        made += unknowns("recording_offset", limit=limit, prior_std=prior_std)
    if turn_limit is not None:
        made += unknowns("recording_turn", limit=turn_limit, prior_std=turn_prior_std)
    return made


QUANTITIES["clamp_stiffness"] = Quantity(
    "stiffness of {of}",
    entry_of("springs.stiffness"),
    noun="support with a stiffness",
    names=attrgetter("springs.names"),
    scales=_FACTOR,
    unit="N/m^3",
    of_configuration=True,
    uncertain="supports",
    role="considered",
    occurs=with_springs,
)


def clamp_stiffness(
    group: str,
    nominal: float,
    *,
    limit: float = 1e3,
    prior_std: float | None,
    each: Sequence[str] = (),
    by: By = "recording",
) -> SetupParameter:
    """Make the stiffness of an elastic support a parameter.

    Args:
        group: Surface group of a `Support` with a stiffness.
        nominal: Nominal stiffness [N/m3].
        limit: Largest ratio to it considered, and 1 over the smallest [-].
        prior_std: Relative prior standard deviation; None if not known [-].
        each: Configurations or recordings with a stiffness each; by default one for
            all.
        by: What `each` names.
    """
    return _unknowns(
        "clamp_stiffness",
        group,
        limit=limit,
        prior_std=prior_std,
        nominal=nominal,
        each=each,
        by=by,
    )[0]
