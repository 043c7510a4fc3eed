"""`KINDS`: all that a kind of unknown of setup, loads and recordings is, a row each.

To add a kind, write a row. From it come the function `fields.<name>` that makes
parameters of it, its table in [[setup]] of a project file, and the key of [uncertain]
with which it counts where it is not fitted, with its words in the budget.
"""

import math
import types
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from inspect import cleandoc
from operator import attrgetter
from textwrap import fill, indent
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._text import UNNAMED_LOADS, check_known
from softcal_jax._typing import Bool, HostArray, is_traced
from softcal_jax.equilibrium import with_offset

Scope = tuple[Hashable | None, ...]
"""For each configuration a key, None where the error cannot occur; configurations with
the same key have the same error."""

Change = Callable[[Any], Any]
Put = Callable[[Any, tuple[int, ...], Change], Any]


class Kind(NamedTuple):
    """A kind of unknown: an array of a model or a configuration, a row of `KINDS`.

    Attributes:
        name: Its name, also of its function and of its key in [[setup]].
        title: Name of an unknown, with {of} and {axis} filled in.
        array: Path of the array, from "model" or from "configuration".
        noun: What its first axis enumerates, like "motor"; empty if nothing.
        names: Names along the first axis, from the owner, which is the model or a
            configuration; by default `names` beside the array.
        components: Names along the last axis; empty for one number.
        relative: Whether errors are relative, as those of factors are; the scale of a
            parameter then is a log one.
        unit: SI unit.
        least: Smallest value that it can have at all, in SI units.
        put: Changes an entry: from the owner, the index, and a function of the old
            value; by default in the array.
        is_noise: Whether an error of it is part of the noise, and not considered.
        uncertain: Key of [uncertain] with its standard deviation there, if any.
        std: The usual one, unless another row or `Uncertain` has it.
        optional: Whether it counts only where its standard deviation is stated.
        about: What has such errors, for the docstring of `Uncertain`.
        remedy: What helps against them, for the budget.
        occurs: Scopes by the name of what it belongs to: from the model, the arrays of
            all configurations on the host, and the names of their recordings. Without,
            an error of it counts only where it is fitted.
        absent: Message if it occurs nowhere, with {of} filled in.
        words: Docstring of its function; without, it has no function and no table.
        unnamed: What it belongs to by default, as `true` in a project file.
        nominal: Whether its function takes the nominal value.
        limit: Largest error by default; largest factor, also in project files.
        each: Whether configurations or recordings may have an unknown each.
        within: The kind in whose function and table it stands, if not in its own.
        prefix: How its arguments begin there, as that of `turn_limit` does.
        section: Where a project file states what it can belong to.
        subjects: What that is, from a project file with its keys as attributes: names,
            with nominal values if the function takes them. By default the model says.
    """

    name: str
    title: str
    array: str
    noun: str = ""
    names: Callable[[Any], Sequence[str]] | None = None
    components: tuple[str, ...] = ()
    relative: bool = False
    unit: str = ""
    least: float = -math.inf
    put: Put | None = None
    is_noise: bool = False
    uncertain: str = ""
    std: float = math.nan
    optional: bool = False
    about: str = ""
    remedy: str = ""
    occurs: Callable[[Any, Any, Sequence[str]], Mapping[str, Scope]] = lambda *_: {}
    absent: str = ""
    words: str = ""
    unnamed: str = ""
    nominal: bool = False
    limit: float | None = None
    each: bool = False
    within: str = ""
    prefix: str = ""
    section: str = "[actuators]"
    subjects: Callable[[Any], Iterable[tuple[Any, ...]]] | None = None

    @property
    def parts(self) -> list["Kind"]:
        """The kinds that stand in its function and table, itself first."""
        return [self, *(kind for kind in KINDS.values() if kind.within == self.name)]

    @property
    def of_configuration(self) -> bool:
        """Whether each configuration has the array, and not the model."""
        return self.array.startswith("configuration.")

    def check(self, model: Any, entry: Any) -> None:
        """Raise ValueError unless the model has the motor or the body of an entry."""
        if not self.of_configuration:
            self._index(model, entry)

    def changed(
        self, model: Any, configuration: Any, entry: Any, change: Change
    ) -> tuple[Any, Any]:
        """Change the array at an entry of a space, of the model or the configuration.

        Raises:
            ValueError: If there is nothing of the name to which the entry belongs.
        """
        owner = configuration if self.of_configuration else model
        if owner is None:
            return model, configuration
        owner = (self.put or self._put)(owner, self._index(owner, entry), change)
        return (model, owner) if self.of_configuration else (owner, configuration)

    def _index(self, owner: Any, entry: Any) -> tuple[int, ...]:
        index, (_, _, path) = (), self.array.partition(".")
        if self.noun:
            beside = attrgetter(f"{path.rpartition('.')[0]}.names")
            names = list((self.names or beside)(owner))
            what = f"{self.noun} of parameter {entry.label!r}"
            check_known(what, [name for name in names if name], entry.of)
            if names.count(entry.of) > 1:
                raise ValueError(
                    f"{what}: {entry.of!r} is the name of two, give them different "
                    "names."
                )
            index = (names.index(entry.of),)
        if self.components:
            index += (self.components.index(entry.axis),)
        return index

    def _put(self, owner: Any, index: tuple[int, ...], change: Change) -> Any:
        where = attrgetter(self.array.partition(".")[2])
        old = where(owner)
        if not is_traced(old):
            # On the host, where nothing is compiled.
            host = np.array(old)
            new = change(host[index])
            if not is_traced(new):
                host[index] = np.asarray(new)
                return eqx.tree_at(where, owner, jax.device_put(host))
        old = jnp.asarray(old)
        return eqx.tree_at(where, owner, old.at[index].set(change(old[index])))


def each_of(names: Sequence[str], has: Bool[HostArray, "n_c n"]) -> dict[str, Scope]:
    """Return a scope for each name: one error for all configurations that have it."""
    return {
        name: tuple("" if has_it else None for has_it in flags)
        for name, flags in zip(names, has.T, strict=True)
        if name
    }


def grounded_bodies(model: Any, arrays: Any) -> Bool[HostArray, "n_c n_b"]:
    """Flag bodies that are held, guided or on a motor, or tied to such a body."""
    bodies, motors = model.mechanism.bodies, model.mechanism.actuators.motor_body
    driven = np.isin(np.arange(bodies.n_bodies), motors)
    return (arrays.bodies.is_guided | driven)[:, bodies.owner]


def _actuators(model: Any, which: Iterable[bool]) -> list[str]:
    """Name all actuators, but "" for those not of a kind."""
    both = zip(model.mechanism.actuators.names, which, strict=True)
    return [name if known else "" for name, known in both]


def _put_friction(model: Any, index: tuple[int, ...], change: Change) -> Any:
    # One coefficient for all configurations: the old one is not needed.
    (k,), mu, mechanism = index, change(None), model.mechanism
    if k < mechanism.n_actuators:
        rough = mechanism.actuators.with_friction(k, mu)
        return eqx.tree_at(lambda m: m.mechanism.actuators, model, rough)
    of_obstacles = jnp.asarray(mechanism.contacts.friction)
    rough = of_obstacles.at[k - mechanism.n_actuators].set(mu)
    return eqx.tree_at(lambda m: m.mechanism.contacts.friction, model, rough)


def _shapes(model: Any, arrays: Any, _: Any) -> Mapping[str, Scope]:
    names = model.shapes.names
    if names and np.any(arrays.is_spread):
        raise ValueError(
            f"the model has shapes ({', '.join(names)}), and elastic supports, and "
            "loads by area or length, do not follow them: hold the body rigidly, load "
            "it at points, or leave `shapes` out."
        )
    return dict.fromkeys(names, ("",) * len(arrays.gravity))


def _rough(model: Any) -> list[str]:
    """Name actuators, then obstacles, but "" for those without friction."""
    contacts, of = model.mechanism.contacts, model.mechanism.actuators.has_friction
    both = zip(contacts.names, contacts.sticks, strict=True)
    return [*_actuators(model, of), *(name if rough else "" for name, rough in both)]


_bodies = attrgetter("mechanism.bodies.names")
_motors = lambda m: _actuators(m, [b >= 0 for b in m.mechanism.actuators.motor_body])


def _heavy_bodies(model: Any, arrays: Any, _: Any) -> Mapping[str, Scope]:
    heavy = np.asarray(model.mechanism.bodies.mass) > 0.0
    weighed = arrays.gravity.any(axis=1, keepdims=True) & heavy
    return each_of(_bodies(model), weighed)


def _obstacles(model: Any, arrays: Any, _: Any) -> Mapping[str, Scope]:
    mechanism = model.mechanism
    which = mechanism.bodies.owner[list(mechanism.contacts.body)]
    stands = np.any(arrays.bodies.is_present[:, which], axis=1)
    stands |= mechanism.contacts.touching is not None
    met = mechanism.contacts.can_touch
    return {"": tuple("" if some else None for some in stands)} if met else {}


def _pulled(model: Any, arrays: Any, _: Any) -> Mapping[str, Scope]:
    by_force = ~arrays.actuation.by_displacement & (arrays.actuation.value != 0.0)
    return each_of(arrays.actuation.names, by_force)


def _named_loads(project: Any) -> Iterator[tuple[str]]:
    return ((load.name,) for c in project.configurations for load in c.loads)


def _movable(project: Any) -> Iterator[tuple[str]]:
    frames = [name for name, e in project.effectors.items() if e.type == "frame"]
    markers = project.markers.positions if project.markers else ()
    return ((name,) for name in (*markers, *frames))


def _stiff_supports(project: Any) -> Iterable[tuple[str, float]]:
    nominal: dict[str, float] = {}
    for support in [s for c in project.configurations for s in c.supports]:
        group, stiffness = support.group, support.stiffness
        if stiffness and nominal.setdefault(group, stiffness) != stiffness:
            raise ValueError(
                f"configurations state several stiffnesses for {group!r}; give one."
            )
    return nominal.items()


_XYZ = ("x", "y", "z")

OFFSET = 0.5e-3
"""Offset of a recording, as long as nothing else is known [m]."""

DEGREE = float(np.deg2rad(1.0))

_ROWS = (
    Kind(
        "motor_zero",
        "zero of {of}",
        "model.mechanism.motor_zero",
        noun="motor",
        names=_motors,
        unit="rad",
        uncertain="zeros",
        std=0.5 * DEGREE,
        about="Zero error of each motor [rad].",
        remedy="calibrate the zeros of the motors",
        occurs=lambda m, c, _: each_of(_motors(m), c.actuation.by_displacement),
        words="Make the zero error of a motor a parameter.",
        subjects=lambda p: ((k,) for k, a in p.actuators.items() if a.type == "motor"),
    ),
    Kind(
        "mounting",
        "mounting {axis} of {of}",
        "model.mechanism.bodies.mounting_translation",
        noun="rigid body",
        components=_XYZ,
        unit="m",
        uncertain="mountings",
        std=0.5e-3,
        about="Place of each held rigid body, along each axis [m].",
        remedy="measure where the bodies are mounted",
        occurs=lambda m, c, _: each_of(_bodies(m), grounded_bodies(m, c)),
        words="Make the three coordinates of the mounting of a rigid body parameters.",
        nominal=True,
        section="[bodies]",
        subjects=lambda p: ((k, b.mounting.translation) for k, b in p.bodies.items()),
    ),
    Kind(
        "body_mass",
        "mass of {of}",
        "model.mechanism.bodies.mass",
        noun="rigid body",
        relative=True,
        unit="kg",
        uncertain="loads",
        occurs=_heavy_bodies,
    ),
    Kind(
        "contact_scale",
        "scale of contact",
        "model.mechanism.contacts.scale",
        relative=True,
        unit="m",
        uncertain="contact",
        occurs=_obstacles,
    ),
    Kind(
        "friction",
        "friction of {of}",
        "model.mechanism.actuators",
        noun="obstacle or actuator with friction",
        names=_rough,
        put=_put_friction,
        least=0.0,
        words="Make the coefficient of friction of a cable or obstacle a parameter.",
        nominal=True,
        subjects=lambda p: (
            (k, rough.friction)
            for k, rough in (*p.actuators.items(), *p.bodies.items())
            if getattr(rough, "friction", None)
        ),
    ),
    Kind(
        "marker_offset",
        "offset {axis} of {of}",
        "configuration.effectors.offset",
        noun="marker or 6-D sensor",
        names=attrgetter("effectors.movable"),
        components=_XYZ,
        unit="m",
        uncertain="mountings",  # placed by the same hands
        words="""Make the place of a marker or 6-D sensor on the body three parameters.

        They are its offset from the nominal place along the axes of the mesh at rest.
        It moves and turns with what carries the marker: to first order, with the tet or
        the affine motion of `Markers.base_radius`.""",
        section="[markers.positions] or [effectors]",
        subjects=_movable,
    ),
    Kind(
        "gravity_tilt",
        "{axis} tilt of gravity",
        "configuration.tilt",
        components=("first", "second"),
        unit="rad",
        uncertain="gravity",
        std=DEGREE,
        about="Direction of gravity in the frame of the mesh, about each of two axes "
        "[rad]. One error for all configurations that state the same gravity.",
        remedy="level the robot",
        occurs=lambda m, c, _: {
            "": tuple(tuple(g) if any(g) else None for g in c.gravity)
        },
        absent="no configuration has gravity",
        words="""Make the direction of gravity two parameters.

        They are angles about two axes normal to it, which are defined in
        `ConfigurationArrays.acceleration`.""",
        limit=10.0 * DEGREE,
        each=True,
    ),
    Kind(
        "recording_offset",
        "offset {axis}",
        "configuration.effectors.base.translation",
        components=_XYZ,
        unit="m",
        is_noise=True,
        uncertain="recordings",
        std=OFFSET,
        about="Offset of the points of a recording, along each axis [m]. Unlike the "
        "others it belongs to the noise, by which a fit weighs its data. "
        '"estimated" takes it from how far recordings differ, where there are enough.',
        remedy="register the recordings better",
        occurs=lambda m, c, recordings: {"": tuple(recordings)},
        words="""Make the frame of a recording, or of a tracker's base, parameters.

        These are three coordinates of its offset, if there is a `limit`, and three of
        its rotation about the centre of the mesh, if there is a `turn_limit`. In
        motions the offset cancels.""",
        each=True,
    ),
    Kind(
        "recording_turn",
        "turn {axis}",
        "configuration.effectors.base.rotation",
        components=_XYZ,
        unit="rad",
        uncertain="gravity",  # a tracker's base is levelled as well as the robot
        within="recording_offset",
        prefix="turn_",
    ),
    Kind(
        "load_factor",
        "factor of {of}",
        "configuration.loads.factor",
        noun="load",
        relative=True,
        uncertain="loads",
        std=0.02,
        about="Dead loads and masses of rigid bodies, relative [-]. One error for each "
        "body, and one for all loads of a name in all configurations, since they are "
        "weighed on the same scale: such an error is not averaged away.",
        remedy="weigh the loads",
        occurs=lambda m, c, _: each_of(c.loads.names, c.loads.force.any((2, 3))),
        absent="no configuration has such a dead load",
        words="Make a factor on dead loads a parameter, for forces known to a percent.",
        unnamed=UNNAMED_LOADS,
        limit=2.0,
        each=True,
        section="`loads` of a configuration",
        subjects=_named_loads,
    ),
    Kind(
        "load_offset",
        "{axis} offset of {of}",
        "configuration.loads.offset",
        noun="load",
        components=_XYZ,
        unit="N",
        uncertain="load_offsets",
        std=5e-3,
        optional=True,
        about="Offset of all dead loads of a name that have a resultant, along each "
        "axis [N]; none unless it is stated.",
        remedy="tare the load cell",
        occurs=lambda m, c, _: each_of(c.loads.names, c.loads.shares.any(2)),
        absent="no configuration has a dead load {of!r} with a resultant force",
        words="""Make a force that adds to dead loads three parameters.

        It acts where the load does, like what a load cell reads without one.""",
        unnamed=UNNAMED_LOADS,
        each=True,
        section="`loads` of a configuration",
        subjects=_named_loads,
    ),
    Kind(
        "actuator_factor",
        "factor of {of}",
        "configuration.actuation.force_factor",
        noun="actuator",
        relative=True,
        uncertain="actuators",
        std=0.02,
        about="Imposed forces, relative [-]. One error for each actuator.",
        remedy="calibrate the sensors of the actuators",
        occurs=_pulled,
        absent="no configuration imposes a force on {of!r}",
        words="Make a factor on the imposed force of an actuator a parameter.",
        limit=2.0,
        each=True,
        subjects=lambda p: ((name,) for name in p.actuators),
    ),
    Kind(
        "command",
        "{of}",
        "configuration.actuation.value",
        noun="actuator",
    ),
    Kind(
        "clamp_stiffness",
        "stiffness of {of}",
        "configuration.springs.stiffness",
        noun="support with a stiffness",
        relative=True,
        unit="N/m^3",
        uncertain="supports",
        std=0.3,
        about="Stiffness of elastic supports, relative [-]. One error for each.",
        remedy="measure how far the supports give way",
        occurs=lambda m, c, _: each_of(c.springs.names, c.springs.stiffness > 0.0),
        words="Make the stiffness of a `Support` on a surface group a parameter.",
        nominal=True,
        limit=1e3,
        each=True,
        section="`supports` of a configuration",
        subjects=_stiff_supports,
    ),
    Kind(
        "shape_offset",
        "offset of {of}",
        "model.shapes.offset",
        noun="shape",
        unit="m",
        put=lambda m, at, new: with_offset(m, at[0], new(m.shapes.offset[at[0]])),
        uncertain="shapes",
        std=0.2e-3,
        about="Offset of each of the `shapes` of a model, as of a printed wall [m]. "
        "None where no shape is named.",
        remedy="measure the part",
        occurs=_shapes,
        words="""Make the offset of a shape a parameter: of a surface, a face, a hole.

        It is one of the `shapes` of `build_model`. Loads by area or length and elastic
        supports do not follow, and are refused.""",
        section="[shapes]",
        subjects=lambda p: ((name,) for name in p.shapes),
    ),
)

KINDS: dict[str, Kind] = {kind.name: kind for kind in _ROWS}
"""Kinds of unknowns that set one entry of an array, by name."""


def _std(usual: float, unit: str = "", remedy: str = "") -> Any:
    """Make a field whose key in [uncertain] has an SI unit, "%", or none."""
    return eqx.field(default=usual, metadata={"unit": unit, "remedy": remedy})


WITH_STD = {kind.uncertain: kind for kind in _ROWS if not math.isnan(kind.std)}
"""The kind that has the usual standard deviation of each key of [uncertain]."""


def _stds_of_kinds() -> Any:
    """Make a class whose fields are the standard deviations of `KINDS`."""
    types_of: dict[str, Any] = {}
    content = {"__annotations__": types_of}
    for key, kind in WITH_STD.items():
        types_of[key] = float | Literal["estimated"] if kind.is_noise else float
        std = 0.0 if kind.optional else kind.std
        content[key] = _std(std, "%" if kind.relative else kind.unit, kind.remedy)
    return types.new_class(
        "AbstractUncertain", (Module,), {}, lambda c: c.update(content)
    )


class Uncertain(_stds_of_kinds()):
    """Standard deviations of what a calibration holds fixed; zero switches one off.

    The defaults are those of careful work on a bench. They count where the robot has
    such a quantity and it is not calibrated; see `ErrorBudget`. The fields are the keys
    of [uncertain] in a project file.

    Attributes:
        nu: Poisson's ratios of the law [-]; at most half of the gap to 1/2.
        density: Density of the body, relative [-]. One error for the whole body.
        clamp: Depth at which a clamp really grips the body, along the normal of its
            faces [m]. One error for all configurations that are held alike.
        contact: Error of the cushion of contact, in units of its scale, see
            `softcal_jax.contact` [-]. One error for all configurations.
        mesh: Error of the mesh, in units of its estimate [-]. One error for all
            configurations, see `mesh_row`. Zero for data that are simulated on the
            same mesh.
    """

    nu: float = _std(0.05)
    density: float = _std(0.03, "%", "weigh the body")
    clamp: float = _std(1e-3, "m", "measure how deep the clamp grips")
    contact: float = _std(1.0)
    mesh: float = _std(1.0)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names of the fields that are not stated, but estimated beside the fit."""
        of_noise = (kind.uncertain for kind in _ROWS if kind.is_noise)
        return tuple(key for key in of_noise if getattr(self, key) == "estimated")

    def __check_init__(self):
        for name, std in vars(self).items():
            if name not in self.estimated and not 0.0 <= float(std) < np.inf:
                raise ValueError(
                    f"uncertainty of {name} must be finite and not negative, got {std}."
                )


for _key, _kind in WITH_STD.items():
    _line = fill(f"{_key}: {_kind.about}", 80, subsequent_indent="    ")
    Uncertain.__doc__ = f"{cleandoc(str(Uncertain.__doc__))}\n{indent(_line, '    ')}"


def exactly_known() -> Uncertain:
    """Return an `Uncertain` that leaves the noise as the only source of error."""
    return Uncertain(**{field.name: 0.0 for field in fields(Uncertain)})
