"""Effectors beside markers: frames, lengths, volumes, angles, forces (paper Sec. II).

Each is a sensor where it has a measured value, and what control brings to a goal.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Literal, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._names import unknown_name
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.bodies import Pose
from softcal_jax.configurations._mechanism import Mechanism
from softcal_jax.mesh import TetMesh, node_indices

Quantity = Literal["point", "turn", "scalar", "force", "reaction"]
"""What a row of three effector coordinates is computed from."""


class EffectorRow(NamedTuple):
    """Up to three coordinates of an effector, as the solver sees them.

    Attributes:
        quantity: What they are.
        unit: Their unit.
        measured: Measured values, or goals; NaN where there is none.
        inverse_std: 1 / standard deviation; 0 for a coordinate that does not count.
        nodes: Nodes that carry a point, or hold a reaction.
        weights: Their weights [-].
        about: Numbers of the bodies or the actuator that it is about.
        axis: Axis of an angle, in the frame of the mesh [-].
        reference: Orientation that turns are counted from, as a matrix [-].
    """

    quantity: Quantity
    unit: str
    measured: Float[HostArray, "3"]
    inverse_std: Float[HostArray, "3"]
    nodes: Int[HostArray, " n"] = np.zeros(0, np.int32)
    weights: Float[HostArray, " n"] = np.zeros(0)
    about: tuple[int, int] = (0, 0)
    axis: Float[HostArray, "3"] = np.zeros(3)
    reference: Float[HostArray, "3 3"] = np.eye(3)


class AbstractEffector(eqx.Module):
    """Something that is measured on the robot, or brought to a goal."""

    name: eqx.AbstractVar[str]

    @abstractmethod
    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        """Its coordinates.

        Args:
            mesh: The mesh at rest.
            mechanism: Rigid bodies and actuators of the model.

        Raises:
            ValueError: If it does not fit them, or its value is not finite.
        """

    @abstractmethod
    def measured_as(
        self, values: Float[HostArray, "k 3"], mechanism: Mechanism
    ) -> "AbstractEffector":
        """The effector with other measured values.

        Args:
            values: One row for each of `rows`, turns counted from rest.
            mechanism: Rigid bodies and actuators of the model.
        """


def _std(name: str, what: str, std: float, unit: str) -> float:
    if not (np.isfinite(std) and std > 0.0):
        raise ValueError(
            f"{what} of effector {name!r} must be positive and finite [{unit}], got "
            f"{std:g}."
        )
    return 1.0 / float(std)


def _one(value: float | None, weight: float, name: str, unit: str):
    """Measured value and weight of a single number, in a row of three."""
    measured, inverse_std = np.full(3, np.nan), np.zeros(3)
    if value is not None:
        if not np.isfinite(value):
            raise ValueError(
                f"effector {name!r} has the value {value}, expected a finite number "
                f"[{unit}]; leave out what was not measured."
            )
        measured[0], inverse_std[0] = value, weight
    return measured, inverse_std


def _number(names: Sequence[str], wanted: str, kind: str, owner: str) -> int:
    if wanted not in names:
        raise unknown_name(f"{kind} of effector {owner!r}", wanted, names)
    return list(names).index(wanted)


def _optional_point(
    value: Float[ArrayLike, "..."] | Sequence[float] | None,
) -> HostArray | None:
    return None if value is None else np.asarray(value, float)


def _point(value: Float[ArrayLike, "3"] | Sequence[float]) -> HostArray:
    return np.asarray(value, float)


class BodyFrame(AbstractEffector):
    """Position and orientation of a rigid body: a 6-D sensor on it.

    Six coordinates: where its point is, and the rotation vector of its orientation
    relative to the measured one, which has no jump at half a turn.

    Attributes:
        name: Its name.
        body: The rigid body.
        measured: Its measured motion from rest: translation of the point, and rotation.
        point: The point, on the mesh at rest; by default the origin of the body's
            frame [m].
        std: Standard deviation of each coordinate of the position [m].
        std_angle: Standard deviation of each coordinate of the rotation [rad].
    """

    name: str
    body: str
    measured: Pose | None = None
    point: Float[HostArray, "3"] | None = eqx.field(
        converter=_optional_point, default=None
    )
    std: float = 1e-3
    std_angle: float = 1e-2

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        """Its position, then its orientation."""
        bodies = mechanism.bodies
        k = _number(bodies.names, self.body, "rigid body", self.name)
        point = bodies.origin[k] if self.point is None else self.point
        weight = _std(self.name, "std", self.std, "m")
        weight_angle = _std(self.name, "std_angle", self.std_angle, "rad")
        nodes = mesh.n_nodes + 4 * k + np.arange(4)
        measured, seen, reference = np.full(3, np.nan), 0.0, np.eye(3)
        if self.measured is not None:
            measured, seen = point + self.measured.translation, 1.0
            reference = self.measured.matrix
        return (
            EffectorRow(
                "point",
                "m",
                measured,
                np.full(3, seen * weight),
                nodes.astype(np.int32),
                bodies.at(k, point[None])[0],
            ),
            EffectorRow(
                "turn",
                "rad",
                np.zeros(3) if seen else np.full(3, np.nan),
                np.full(3, seen * weight_angle),
                about=(k, 0),
                reference=reference,
            ),
        )

    def measured_as(
        self, values: Float[HostArray, "k 3"], mechanism: Mechanism
    ) -> "BodyFrame":
        """With a position [m], and a rotation vector from rest [rad]."""
        k = mechanism.bodies.names.index(self.body)
        point = mechanism.bodies.origin[k] if self.point is None else self.point
        return replace(self, measured=Pose(values[0] - point, values[1]))


class Centroid(AbstractEffector):
    """Mean position of a group of nodes.

    Attributes:
        name: Its name.
        where: The group, or node indices.
        measured: Measured position [m].
        std: Standard deviation of each coordinate [m].
    """

    name: str
    where: str | Int[HostArray, " n"]
    measured: Float[HostArray, "3"] | None = eqx.field(
        converter=_optional_point, default=None
    )
    std: float = 1e-3

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        """Its position."""
        del mechanism
        nodes = node_indices(mesh, self.where, f"effector {self.name!r}")
        weight = _std(self.name, "std", self.std, "m")
        known = self.measured is not None
        measured = np.full(3, np.nan) if self.measured is None else self.measured
        if known and not np.all(np.isfinite(measured)):
            raise ValueError(
                f"effector {self.name!r} is at {self.measured}, expected three finite "
                "numbers [m]; leave out what was not measured."
            )
        return (
            EffectorRow(
                "point",
                "m",
                measured,
                np.full(3, weight if known else 0.0),
                nodes.astype(np.int32),
                np.full(nodes.size, 1.0 / nodes.size),
            ),
        )

    def measured_as(
        self, values: Float[HostArray, "k 3"], mechanism: Mechanism
    ) -> "Centroid":
        """With a position [m]."""
        del mechanism
        return replace(self, measured=values[0])


class ActuatorDisplacement(AbstractEffector):
    """Displacement delta_a of an actuator: length of a cable, volume of a chamber.

    Attributes:
        name: Its name.
        actuator: The actuator.
        measured: Measured displacement from rest, in the unit of the actuator.
        std: Its standard deviation.
    """

    name: str
    actuator: str
    measured: float | None = None
    std: float = 1e-3

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        """Its single coordinate."""
        del mesh
        actuators = mechanism.actuators
        a = _number(actuators.names, self.actuator, "actuator", self.name)
        unit = actuators.kinds[a].displacement_unit
        if unit is None:
            raise ValueError(
                f"effector {self.name!r}: {actuators.kinds[a].noun} {self.actuator!r} "
                "has no displacement; use ActuatorForce."
            )
        weight = _std(self.name, "std", self.std, unit)
        values = _one(self.measured, weight, self.name, unit)
        return (EffectorRow("scalar", unit, *values, about=(a, -1)),)

    def measured_as(
        self, values: Float[HostArray, "k 3"], mechanism: Mechanism
    ) -> "ActuatorDisplacement":
        """With a displacement."""
        del mechanism
        return replace(self, measured=float(values[0, 0]))


class ActuatorForce(AbstractEffector):
    """Force lambda_a of an actuator: tension, pressure, reaction torque of a motor.

    Attributes:
        name: Its name.
        actuator: The actuator.
        measured: Measured force, in the unit of the actuator.
        std: Its standard deviation.
    """

    name: str
    actuator: str
    measured: float | None = None
    std: float = 1e-2

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        """Its single coordinate."""
        del mesh
        actuators = mechanism.actuators
        a = _number(actuators.names, self.actuator, "actuator", self.name)
        unit = actuators.kinds[a].force_unit
        weight = _std(self.name, "std", self.std, unit)
        values = _one(self.measured, weight, self.name, unit)
        return (EffectorRow("force", unit, *values, about=(a, 0)),)

    def measured_as(
        self, values: Float[HostArray, "k 3"], mechanism: Mechanism
    ) -> "ActuatorForce":
        """With a force."""
        del mechanism
        return replace(self, measured=float(values[0, 0]))


class BodyAngle(AbstractEffector):
    """Angle by which one rigid body has turned against another.

    Attributes:
        name: Its name.
        body: The body that turns.
        other: The body it is measured from.
        axis: Axis of the angle, fixed on `other`, as it lies at rest [-].
        measured: Measured angle from rest [rad].
        std: Its standard deviation [rad].
    """

    name: str
    body: str
    other: str
    axis: Float[HostArray, "3"] = eqx.field(converter=_point)
    measured: float | None = None
    std: float = 1e-2
    unit: ClassVar[str] = "rad"

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        """Its single coordinate."""
        del mesh
        names = mechanism.bodies.names
        pair = (
            _number(names, self.body, "rigid body", self.name),
            _number(names, self.other, "rigid body", self.name),
        )
        length = np.linalg.norm(self.axis)
        if self.axis.shape != (3,) or not (np.isfinite(length) and length > 0.0):
            raise ValueError(
                f"axis of effector {self.name!r} must be three finite numbers, not all "
                f"zero, got {self.axis}."
            )
        weight = _std(self.name, "std", self.std, self.unit)
        values = _one(self.measured, weight, self.name, self.unit)
        row = EffectorRow("scalar", "rad", *values, about=pair, axis=self.axis / length)
        return (row,)

    def measured_as(
        self, values: Float[HostArray, "k 3"], mechanism: Mechanism
    ) -> "BodyAngle":
        """With an angle [rad]."""
        del mechanism
        return replace(self, measured=float(values[0, 0]))


class SupportReaction(AbstractEffector):
    """Force with which the ground holds a group of nodes: a load cell under a clamp.

    Attributes:
        name: Its name.
        where: The group, or node indices.
        measured: Measured force of the support on the body [N].
        std: Standard deviation of each coordinate [N].
    """

    name: str
    where: str | Int[HostArray, " n"]
    measured: Float[HostArray, "3"] | None = eqx.field(
        converter=_optional_point, default=None
    )
    std: float = 1e-2

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        """Its three coordinates."""
        del mechanism
        nodes = node_indices(mesh, self.where, f"effector {self.name!r}")
        weight = _std(self.name, "std", self.std, "N")
        known = self.measured is not None
        measured = np.full(3, np.nan) if self.measured is None else self.measured
        if known and not np.all(np.isfinite(measured)):
            raise ValueError(
                f"effector {self.name!r} measured {measured}, expected three finite "
                "numbers [N]; leave out what was not measured."
            )
        return (
            EffectorRow(
                "reaction",
                "N",
                measured,
                np.full(3, weight if known else 0.0),
                nodes.astype(np.int32),
                np.ones(nodes.size),
            ),
        )

    def measured_as(
        self, values: Float[HostArray, "k 3"], mechanism: Mechanism
    ) -> "SupportReaction":
        """With a force [N]."""
        del mechanism
        return replace(self, measured=values[0])
