"""The kinds of effectors: frames, positions, angles, lengths, volumes, forces."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import numpy as np

from softcal_jax._module import key
from softcal_jax._text import check_known
from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.bodies import (
    BodyArrays,
    Pose,
    angle_about,
    as_floats,
    optional,
    unit_vector,
)
from softcal_jax.configurations._effector import (
    AbstractEffector,
    AbstractScalar,
    EffectorRow,
    Readings,
    Unstated,
    effector_row,
)
from softcal_jax.configurations._mechanism import Mechanism
from softcal_jax.mesh import TetMesh, node_indices


class _Reading(NamedTuple):
    """A function like that of `Observation`; equal if `function` and `of` are equal."""

    function: Callable[..., Any]
    of: tuple[Any, ...]

    def __call__(self, model, configuration, state) -> Float[Array | HostArray, "..."]:
        return self.function(state, *self.of)


def _reaction(state, nodes: tuple[int, ...]) -> Float[Array | HostArray, "3"]:
    return state.ground_forces[np.array(nodes, int)].sum(axis=0)


def _contact(state, what: str, obstacle: int, axis: tuple[float, ...] | None):
    value = getattr(state.contacts[obstacle], what)
    return value if axis is None else (value * np.array(axis)).sum()


def _angle(state, body: int, other: int, axis: tuple[float, ...]) -> Float[Array, ""]:
    R = state.body_rotations
    return angle_about(R[body], R[other], np.array(axis))


def _of_actuator(state, what: str, actuator: int) -> Float[Array, ""]:
    return getattr(state, what)[actuator]


_BODY = key(words='name of a rigid body, [bodies.NAME]: "plate"')
_GROUP = key(words='name of a group of the mesh: "x_min"', key="group")
_ACTUATOR = key(words='name of an actuator, [actuators.NAME]: "cable"')
_STD = key(
    words='standard deviation, with the unit of what is measured: "0.1 mm"',
    required=True,
)


class BodyFrame(AbstractEffector):
    """Position and orientation of a rigid body: a 6-D sensor on it.

    It has six coordinates: the position of its point, and the rotation vector of its
    orientation relative to the measured one, which has no jump at half a turn.

    Attributes:
        body: The rigid body.
        measured: Its measured motion from rest: translation of the point, and rotation.
        point: The point, on the mesh at rest; by default the origin of the body's
            frame [m].
        std: Standard deviation of each coordinate of the position, one for all or one
            for each [m].
        std_angle: Likewise of the rotation vector [rad].
    """

    name: str
    body: str = eqx.field(metadata=_BODY)
    measured: Pose | None = None
    point: Float[HostArray, "3"] | None = eqx.field(
        converter=optional, default=None, metadata=key("m")
    )
    std: float | Float[HostArray, "3"] = Unstated(1e-3)
    std_angle: float | Float[HostArray, "3"] = eqx.field(
        default=Unstated(1e-2), metadata=key("rad", size="any")
    )

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        k, point = self._place(mechanism.bodies)
        nodes = (mesh.n_nodes + 4 * k + np.arange(4)).astype(np.int32)
        weights, *along = mechanism.bodies.at(k, point + np.eye(4, 3, -1))
        slopes = np.array(along).T - weights[:, None]
        carriers = {"nodes": nodes, "weights": weights, "slopes": slopes}
        seen, pose = self.measured is not None, self.measured or Pose()
        value, turn = (point + pose.translation, np.zeros(3)) if seen else (None, None)
        about = {"what": "std_angle", "body": k, "reference": pose.matrix}
        return (
            effector_row(self.name, "point", "m", value, self.std, **carriers),
            effector_row(self.name, "turn", "rad", turn, self.std_angle, **about),
        )

    def _place(self, bodies: BodyArrays) -> tuple[int, Float[HostArray, "3"]]:
        """Return the index of its body, and its point at rest [m]."""
        k = _index_of(self.body, bodies.names, "rigid body", self.name)
        return k, bodies.origin[k] if self.point is None else self.point

    def measured_as(self, values: Readings, mechanism: Mechanism) -> "BodyFrame":
        """Replace the measured position [m] and rotation vector from rest [rad]."""
        _, point = self._place(mechanism.bodies)
        return replace(self, measured=Pose(values[0] - point, values[1]))


class Centroid(AbstractEffector):
    """Mean position of a group of nodes.

    Attributes:
        where: The group, or node indices.
        measured: Measured position [m].
        std: Standard deviation of each coordinate [m].
    """

    name: str
    where: str | Int[HostArray, " n"] = eqx.field(metadata=_GROUP)
    measured: Float[HostArray, "3"] | None = eqx.field(converter=optional, default=None)
    std: float = Unstated(1e-3)

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        nodes = node_indices(mesh, self.where, f"effector {self.name!r}")
        nodes, weights = nodes.astype(np.int32), np.full(nodes.size, 1.0 / nodes.size)
        return self._row("point", "m", nodes=nodes, weights=weights)


class SupportReaction(AbstractEffector):
    """Force with which the ground holds a group of nodes: a load cell under a clamp.

    A rigid body among them is held as a whole: the reaction includes its own mass, what
    pulls at it, and bodies that are tied to it.

    Attributes:
        where: The group, or node indices.
        measured: Measured force of the support on the body [N].
        std: Standard deviation of each coordinate [N].
    """

    name: str
    where: str | Int[HostArray, " n"] = eqx.field(metadata=_GROUP)
    measured: Float[HostArray, "3"] | None = eqx.field(converter=optional, default=None)
    std: float = Unstated(1e-2)

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        nodes = node_indices(mesh, self.where, f"effector {self.name!r}")
        nodes = _with_bodies(nodes, mesh, mechanism.bodies, self.name)
        reading = _Reading(_reaction, (tuple(nodes.tolist()),))
        return self._row("reaction", "N", function=reading)


class ContactForce(AbstractEffector):
    """Force of the robot on an obstacle: the force sensor of a probe.

    Attributes:
        body: The obstacle, a rigid body with a shape; or two surfaces that may touch,
            "upper on lower".
        axis: Direction along which the sensor measures; by default it measures all
            three coordinates, in the frame of the mesh [-].
        measured: Measured force, one number or three [N].
        std: Its standard deviation [N].
    """

    name: str
    body: str = eqx.field(
        metadata=key(words='an obstacle, [bodies.NAME] with a shape: "probe"')
    )
    axis: Float[HostArray, "3"] | None = eqx.field(
        converter=optional, default=None, metadata=key("")
    )
    measured: float | Float[HostArray, "3"] | None = eqx.field(
        converter=lambda value: optional(value) if np.ndim(value) else value,
        default=None,
    )
    std: float = Unstated(1e-2)
    quantity: ClassVar[tuple[str, str]] = "force", "N"

    @property
    def n_values(self) -> int:
        return 3 if self.axis is None else 1

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        of, kind = mechanism.contacts.touched, "obstacle or touching pair"
        contact = _index_of(self.body, of, kind, self.name)
        axis, (what, unit) = self.axis, self.quantity
        if axis is not None:
            axis = tuple(unit_vector(f"axis of effector {self.name!r}", axis).tolist())
        reading = _Reading(_contact, (what, contact, axis))
        return self._row("reaction", unit, function=reading)


class ContactMoment(ContactForce):
    """Moment of the robot on an obstacle about the origin of its frame [N m].

    Its attributes are those of `ContactForce`.
    """

    std: float = Unstated(1e-4)
    quantity: ClassVar[tuple[str, str]] = "moment", "N m"


class BodyAngle(AbstractScalar):
    """Angle by which one rigid body has turned against another.

    Attributes:
        body: The body that turns.
        other: The body it is measured from.
        axis: Axis of the angle, fixed to `other`, as it lies at rest [-].
        measured: Measured angle from rest [rad].
        std: Its standard deviation [rad].
    """

    name: str
    body: str = eqx.field(metadata=_BODY)
    other: str = eqx.field(metadata=key(words="the rigid body it is measured from"))
    axis: Float[HostArray, "3"] = eqx.field(
        converter=as_floats,
        metadata=key("", 'axis of the angle, fixed on `other`: "z", or [0, 0, 1]'),
    )
    measured: float | None = None
    std: float = Unstated(1e-2)

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        names = mechanism.bodies.names
        body = _index_of(self.body, names, "rigid body", self.name)
        other = _index_of(self.other, names, "rigid body", self.name)
        axis = unit_vector(f"axis of effector {self.name!r}", self.axis)
        reading = _Reading(_angle, (body, other, tuple(axis.tolist())))
        return self._row("scalar", "rad", function=reading)


class ActuatorDisplacement(AbstractScalar):
    """Displacement delta_a of an actuator: length of a cable, volume of a chamber.

    It counts from rest, in the unit of the actuator. For a motor it is the reading of
    its encoder, as for `ImposedDisplacement`: the angle of its body minus the zero
    error. `BodyFrame` and `BodyAngle` give the angle itself.
    """

    name: str
    actuator: str = eqx.field(metadata=_ACTUATOR)
    measured: float | None = None
    std: float = eqx.field(default=Unstated(1e-3), metadata=_STD)

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        a = _index_of(self.actuator, mechanism.actuators.names, "actuator", self.name)
        kind = mechanism.actuators.kinds[a]
        if kind.displacement_unit is None:
            raise ValueError(
                f"effector {self.name!r}: {kind.noun} {self.actuator!r} has no "
                'displacement; use ActuatorForce (type = "actuator-force" in a file).'
            )
        reading = _Reading(_of_actuator, ("actuator_displacements", a))
        return self._row("scalar", kind.displacement_unit, function=reading)


class ActuatorForce(AbstractScalar):
    """Force lambda_a of an actuator, in its unit: tension, pressure, torque."""

    name: str
    actuator: str = eqx.field(metadata=_ACTUATOR)
    measured: float | None = None
    std: float = eqx.field(default=Unstated(1e-2), metadata=_STD)

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        a = _index_of(self.actuator, mechanism.actuators.names, "actuator", self.name)
        unit = mechanism.actuators.kinds[a].force_unit
        reading = _Reading(_of_actuator, ("actuator_forces", a))
        return self._row("force", unit, function=reading)


class Observation(AbstractEffector):
    """A reading of one's own: any function of the robot in equilibrium.

    Its derivatives are found by autodiff, so JAX must be able to differentiate it.

    Attributes:
        function: Takes model, configuration (a lane of `lanes`) and state; returns one
            number, or a vector of two or three. The state has the `displacement` of the
            nodes [m], `actuator_forces` lambda_a and `actuator_displacements` delta_a
            of all actuators, `ground_forces` on the nodes [N], and `body_rotations` as
            matrices.
        unit: Its unit, for tables.
        measured: Measured value, with as many numbers.
        std: Standard deviation, one for all or one for each; as many as there are
            values where nothing is measured. It must be given.

    Example:
        The stored energy of a robot::

            def stored(model, configuration, state):
                return energy_and_force(model, state.displacement)[0]

            Observation("stored", stored, "J", measured=0.013, std=1e-3)
    """

    name: str
    function: Callable[..., Any] = eqx.field(static=True)
    unit: str
    measured: float | Float[HostArray, " k"] | None = None
    std: float | Float[HostArray, " k"] = Unstated(math.nan)

    def __check_init__(self):
        if isinstance(self.std, Unstated):
            raise ValueError(f"effector {self.name!r} needs a std [{self.unit}].")

    @property
    def n_values(self) -> int:
        """Number of values, as many as are measured, or else as `std` has."""
        return np.size(self.std if self.measured is None else self.measured)

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        n = self.n_values
        if not 1 <= n <= 3:
            raise ValueError(
                f"effector {self.name!r} has {n} values; expected one to three. Give a "
                "longer reading in several observations."
            )
        if np.size(self.std) not in (1, n):
            raise ValueError(
                f"std of effector {self.name!r} has {np.size(self.std)} values, its "
                f"measured value {n}: give one for all, or one for each."
            )
        return self._row("observation", self.unit, function=self.function)


EFFECTORS: dict[str, type[AbstractEffector]] = {
    "frame": BodyFrame,
    "centroid": Centroid,
    "reaction": SupportReaction,
    "contact-force": ContactForce,
    "contact-moment": ContactMoment,
    "angle": BodyAngle,
    "actuator-displacement": ActuatorDisplacement,
    "actuator-force": ActuatorForce,
}
"""The effectors that project files make, as they call them."""


def _index_of(wanted: str, names: Sequence[str], kind: str, owner: str) -> int:
    check_known(f"{kind} of effector {owner!r}", names, wanted)
    return list(names).index(wanted)


def _with_bodies(
    nodes: Int[HostArray, " n"], mesh: TetMesh, bodies: BodyArrays, name: str
) -> Int[HostArray, " _"]:
    """Add, for bodies among the nodes, all nodes by which the ground holds them.

    These include the frame nodes of a body, on which masses and cables act.
    """
    inside, whole = np.isin(bodies.attached, nodes), set()
    for k, body in enumerate(bodies.names):
        of_body = inside[bodies.body == k]
        if of_body.size and of_body.all():
            whole.add(k)
        elif of_body.any():
            raise ValueError(
                f"effector {name!r} names {of_body.sum()} of the {of_body.size} nodes "
                f"of rigid body {body!r}, which is held as a whole: name all or none."
            )
    carried = [k for k, owner in enumerate(bodies.owner) if {k, owner} & whole]
    frames = [mesh.n_nodes + 4 * k + np.arange(4) for k in carried]
    attached = bodies.attached[np.isin(bodies.body, carried)]
    return np.unique(np.concatenate([nodes, attached, *frames])).astype(np.int32)
