"""The kinds of parameters of setup, loads and recordings, each with its constructor.

To add a kind, declare here what it sets and where it can occur, and write the function
that makes parameters of it, which `fields` exports and `project._setup` gives a table.
A kind that counts even if it is not fitted has a standard deviation in `Uncertain`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import partial
from operator import attrgetter
from typing import Any, Literal

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._module import Module
from softcal_jax._names import UNNAMED_LOADS
from softcal_jax._typing import Float
from softcal_jax.fields._parameters import Parameter
from softcal_jax.fields._setup import (
    QUANTITIES,
    By,
    Change,
    Poses,
    Quantity,
    Scope,
    SetupParameter,
    actuators_where,
    each_of,
    entry_of,
    grounded_bodies,
    setup_parameters,
)

_XYZ = ("x", "y", "z")

OFFSET = 0.5e-3
"""Offset of a recording, as long as nothing else is known [m]."""

DEGREE = float(np.deg2rad(1.0))


def _std(usual: float, unit: str = "") -> Any:
    """Make a field whose key in [uncertain] has an SI unit, "%", or none."""
    return eqx.field(default=usual, metadata={"unit": unit})


class Uncertain(Module):
    """Standard deviations of what a calibration holds fixed; zero switches one off.

    The defaults are those of careful work on a bench. They count where the robot has
    such a quantity and it is not calibrated; see `ErrorBudget`. The fields are the keys
    of [uncertain] in a project file.

    Attributes:
        nu: Poisson's ratios of the law [-]; at most half of the gap to 1/2.
        density: Density of the body, relative [-]. One error for the whole body.
        gravity: Direction of gravity in the frame of the mesh, about each of two axes
            [rad]. One error for all configurations that state the same gravity.
        loads: Dead loads and masses of rigid bodies, relative [-]. One error for each
            body, and one for all loads of a name in all configurations, since they are
            weighed on the same scale: such an error is not averaged away.
        actuators: Imposed forces, relative [-]. One error for each actuator.
        clamp: Depth at which a clamp really grips the body, along the normal of its
            faces [m]. One error for all configurations that are held alike.
        supports: Stiffness of elastic supports, relative [-]. One error for each.
        recordings: Offset of the points of a recording, along each axis [m]. Unlike the
            other fields it belongs to the noise, by which a fit weighs its data.
            "estimated" takes it from how far recordings differ, where there are enough.
        zeros: Zero error of each motor [rad].
        mountings: Place of each held rigid body, along each axis [m].
        contact: Error of the cushion on obstacles, in units of its scale, see
            `softcal_jax.contact` [-]. One error for all configurations.
        mesh: Error of the mesh, in units of its estimate [-]. One error for all
            configurations, see `mesh_row`. Zero for data that are simulated on the
            same mesh.
    """

    nu: float = _std(0.05)
    density: float = _std(0.03, "%")
    gravity: float = _std(DEGREE, "rad")
    loads: float = _std(0.02, "%")
    actuators: float = _std(0.02, "%")
    clamp: float = _std(1e-3, "m")
    supports: float = _std(0.3, "%")
    recordings: float | Literal["estimated"] = _std(OFFSET, "m")
    zeros: float = _std(0.5 * DEGREE, "rad")
    mountings: float = _std(0.5e-3, "m")
    contact: float = _std(1.0)
    mesh: float = _std(1.0)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names of the fields that are not stated, but estimated beside the fit."""
        of_noise = {q.uncertain for q in QUANTITIES.values() if q.role == "noise"}
        return tuple(n for n in sorted(of_noise) if getattr(self, n) == "estimated")

    def __check_init__(self):
        for name, std in vars(self).items():
            if name not in self.estimated and not 0.0 <= float(std) < np.inf:
                raise ValueError(
                    f"uncertainty of {name} must be finite and not negative, got {std}."
                )


def exactly_known() -> Uncertain:
    """Return an `Uncertain` that leaves the noise as the only source of error."""
    return Uncertain(**{field.name: 0.0 for field in fields(Uncertain)})


_MOTORS = actuators_where(lambda a: [body >= 0 for body in a.motor_body])

QUANTITIES["motor_zero"] = Quantity(
    "zero of {of}",
    entry_of("mechanism.motor_zero"),
    noun="motor",
    names=_MOTORS,
    unit="rad",
    uncertain="zeros",
    occurs=lambda p: each_of(_MOTORS(p.model), p.arrays.actuation.by_displacement),
)


def motor_zero(motor: str, *, limit: float, prior_std: float | None) -> SetupParameter:
    """Make the zero error of a motor a parameter.

    `limit` is the largest error [rad], `prior_std` None if not known [rad].
    """
    return setup_parameters("motor_zero", motor, limit=limit, prior_std=prior_std)[0]


QUANTITIES["mounting"] = Quantity(
    "mounting {axis} of {of}",
    entry_of("mechanism.bodies.mounting_translation"),
    noun="rigid body",
    names=attrgetter("mechanism.bodies.names"),
    components=_XYZ,
    unit="m",
    uncertain="mountings",
    occurs=lambda p: each_of(p.model.mechanism.bodies.names, grounded_bodies(p)),
)


def mounting(
    body: str,
    nominal: Float[ArrayLike, "3"] | Sequence[float],
    *,
    limit: float,
    prior_std: float | None,
) -> tuple[SetupParameter, ...]:
    """Make the three coordinates of the mounting of a rigid body parameters.

    They are about the `nominal` translation [m]. `limit` is the largest error per axis
    [m], `prior_std` None if not known [m].
    """
    return setup_parameters(
        "mounting", body, limit=limit, prior_std=prior_std, nominal=nominal
    )


def _obstacles(poses: Poses) -> Mapping[str, Scope]:
    mechanism = poses.model.mechanism
    which = mechanism.bodies.owner[list(mechanism.contacts.body)]
    stands = np.any(poses.arrays.bodies.is_present[:, which], axis=1)
    return {"": tuple("" if some else None for some in stands)} if which.size else {}


QUANTITIES["body_mass"] = Quantity(
    "mass of {of}",
    entry_of("mechanism.bodies.mass"),
    noun="rigid body",
    names=attrgetter("mechanism.bodies.names"),
    relative=True,
    unit="kg",
    uncertain="loads",
    occurs=lambda p: each_of(
        p.model.mechanism.bodies.names,
        p.arrays.gravity.any(axis=1, keepdims=True)
        & (np.asarray(p.model.mechanism.bodies.mass) > 0.0),
    ),
)

QUANTITIES["contact_scale"] = Quantity(
    "scale of contact",
    entry_of("mechanism.contacts.scale"),
    relative=True,
    unit="m",
    uncertain="contact",
    occurs=_obstacles,
)


def _put_friction(model: Any, index: tuple[int, ...], change: Change) -> Any:
    # One coefficient for all configurations: the old one is not needed.
    actuators = model.mechanism.actuators.with_friction(*index, change(None))
    return eqx.tree_at(lambda m: m.mechanism.actuators, model, actuators)


QUANTITIES["friction"] = Quantity(
    "friction of {of}",
    _put_friction,
    noun="actuator with friction",
    names=actuators_where(attrgetter("has_friction")),
    least=0.0,
    role="none",
)


def friction(
    actuator: str, nominal: float, *, limit: float, prior_std: float | None
) -> SetupParameter:
    """Make the coefficient of friction of a cable with friction a parameter.

    It is about the `nominal` one, with `limit` as the largest error, and stays above
    zero; `prior_std` is None if not known [-].
    """
    return setup_parameters(
        "friction", actuator, limit=limit, prior_std=prior_std, nominal=nominal
    )[0]


QUANTITIES["gravity_tilt"] = Quantity(
    "{axis} tilt of gravity",
    entry_of("tilt"),
    components=("first", "second"),
    unit="rad",
    of_configuration=True,
    uncertain="gravity",
    occurs=lambda p: {
        "": tuple(tuple(g) if any(g) else None for g in p.arrays.gravity)
    },
    absent="no configuration has gravity",
)


def gravity_tilt(
    *,
    limit: float = 10.0 * DEGREE,
    prior_std: float | None,
    each: Sequence[str] = (),
    by: By = "recording",
) -> tuple[SetupParameter, ...]:
    """Make the direction of gravity two parameters: angles about two axes normal to it.

    The axes are defined in `ConfigurationArrays.acceleration`. `limit` is the largest
    tilt per axis [rad], `prior_std` None if not known [rad]; for `each` and `by` see
    `SetupParameter`.
    """
    return setup_parameters(
        "gravity_tilt", limit=limit, prior_std=prior_std, each=each, by=by
    )


QUANTITIES["load_factor"] = Quantity(
    "factor of {of}",
    entry_of("loads.factor"),
    noun="load",
    names=attrgetter("loads.names"),
    relative=True,
    of_configuration=True,
    uncertain="loads",
    occurs=lambda p: each_of(p.arrays.loads.names, p.arrays.loads.force.any((2, 3))),
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

    By default it is of the loads without a name of their own. `limit` is the largest
    factor, and 1 over the smallest [-]; `prior_std` is relative, like 0.05, and None if
    not known [-]; for `each` and `by` see `SetupParameter`.
    """
    return setup_parameters(
        "load_factor", load, limit=limit, prior_std=prior_std, each=each, by=by
    )[0]


QUANTITIES["actuator_factor"] = Quantity(
    "factor of {of}",
    entry_of("actuation.force_factor"),
    noun="actuator",
    names=attrgetter("actuation.names"),
    relative=True,
    of_configuration=True,
    uncertain="actuators",
    occurs=lambda p: each_of(
        p.arrays.actuation.names,
        ~p.arrays.actuation.by_displacement & (p.arrays.actuation.value != 0.0),
    ),
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

    The options are those of `load_factor`.
    """
    return setup_parameters(
        "actuator_factor", actuator, limit=limit, prior_std=prior_std, each=each, by=by
    )[0]


QUANTITIES["command"] = Quantity(
    "{of}",
    entry_of("actuation.value"),
    noun="actuator",
    names=attrgetter("actuation.names"),
    of_configuration=True,
    role="none",
)


def command(
    actuator: str,
    start: Mapping[str, float],
    limits: Mapping[str, tuple[float, float]],
    *,
    unit: str,
) -> SetupParameter:
    """Make what is imposed on an actuator a parameter of each configuration.

    `start` has its value by configuration, and `limits` the smallest and the largest
    one, in the SI `unit` of its force or displacement. Configurations of one recording
    share it, under the name of that.
    """
    unknowns = [
        Parameter(
            f"{actuator} in {name}", "", value, *limits[name], scale="linear", unit=unit
        )
        for name, value in start.items()
    ]
    return SetupParameter(
        kind="command",
        of=actuator,
        unknowns=unknowns,
        each=tuple(start),
        by="recording",
    )


QUANTITIES["recording_offset"] = Quantity(
    "offset {axis}",
    entry_of("effectors.base.translation"),
    components=_XYZ,
    unit="m",
    of_configuration=True,
    uncertain="recordings",
    role="noise",
    occurs=lambda p: {"": tuple(p.recordings)},
)
QUANTITIES["recording_turn"] = Quantity(
    "turn {axis}",
    entry_of("effectors.base.rotation"),
    components=_XYZ,
    unit="rad",
    of_configuration=True,
    uncertain="gravity",  # a tracker's base is levelled as well as the robot
    role="none",
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

    These are three coordinates of its offset, if there is a `limit` per axis [m], and
    three of its rotation about the centre of the mesh, if there is a `turn_limit`
    [rad]. In motions the offset cancels. Prior standard deviations, [m] and [rad], are
    None if not known; for `each` and `by` see `SetupParameter`.

    Raises:
        ValueError: If neither limit is given.
    """
    if limit is None and turn_limit is None:
        raise ValueError("a recording_offset needs limit, turn_limit or both.")
    unknowns = partial(setup_parameters, each=each, by=by)
    made: tuple[SetupParameter, ...] = ()
    if limit is not None:
        made += unknowns("recording_offset", limit=limit, prior_std=prior_std)
    if turn_limit is not None:
        made += unknowns("recording_turn", limit=turn_limit, prior_std=turn_prior_std)
    return made


QUANTITIES["marker_offset"] = Quantity(
    "offset {axis} of {of}",
    entry_of("effectors.offset"),
    noun="marker or 6-D sensor",
    names=attrgetter("effectors.movable"),
    components=_XYZ,
    unit="m",
    of_configuration=True,
    uncertain="mountings",  # placed by the same hands
    role="none",
)


def marker_offset(
    marker: str, *, limit: float, prior_std: float | None
) -> tuple[SetupParameter, ...]:
    """Make the place of a marker or 6-D sensor on the body three parameters.

    They are its offset from the nominal place along the axes of the mesh at rest. It
    moves and turns with what carries the marker: to first order, with the tet or the
    affine motion of `Markers.base_radius`. `limit` is the largest offset per axis [m],
    `prior_std` None if not known [m].
    """
    return setup_parameters("marker_offset", marker, limit=limit, prior_std=prior_std)


QUANTITIES["clamp_stiffness"] = Quantity(
    "stiffness of {of}",
    entry_of("springs.stiffness"),
    noun="support with a stiffness",
    names=attrgetter("springs.names"),
    relative=True,
    unit="N/m^3",
    of_configuration=True,
    uncertain="supports",
    occurs=lambda p: each_of(p.arrays.springs.names, p.arrays.springs.stiffness > 0.0),
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

    It is that of the surface group of a `Support`, about the `nominal` one [N/m3]. The
    options are those of `load_factor`.
    """
    return setup_parameters(
        "clamp_stiffness",
        group,
        limit=limit,
        prior_std=prior_std,
        nominal=nominal,
        each=each,
        by=by,
    )[0]
