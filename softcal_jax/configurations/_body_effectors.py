"""Effectors that follow from positions: frames, mean positions, angles."""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.bodies import Pose
from softcal_jax.configurations._effector import (
    AbstractEffector,
    AbstractScalar,
    AbstractVector,
    EffectorRow,
    index_of,
    inverse_std,
    optional_point,
    scalar_rows,
    vector_rows,
)
from softcal_jax.configurations._mechanism import Mechanism
from softcal_jax.mesh import TetMesh, node_indices


def _point(value: Float[ArrayLike, "3"] | Sequence[float]) -> HostArray:
    return np.asarray(value, float)


class BodyFrame(AbstractEffector):
    """Position and orientation of a rigid body: a 6-D sensor on it.

    It has six coordinates: the position of its point, and the rotation vector of its
    orientation relative to the measured one, which has no jump at half a turn.

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
        converter=optional_point, default=None
    )
    std: float = 1e-3
    std_angle: float = 1e-2

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        """Return its position, then its orientation."""
        bodies = mechanism.bodies
        k = index_of(self.body, bodies.names, "rigid body", self.name)
        point = bodies.origin[k] if self.point is None else self.point
        weight = inverse_std(self.name, "std", self.std, "m")
        weight_angle = inverse_std(self.name, "std_angle", self.std_angle, "rad")
        nodes = mesh.n_nodes + 4 * k + np.arange(4)
        measured, seen, reference = np.full(3, np.nan), 0.0, np.eye(3)
        if self.measured is not None:
            measured, seen = point + self.measured.translation, 1.0
            reference = self.measured.matrix
        return (
            EffectorRow(
                name=self.name,
                quantity="point",
                unit="m",
                measured=measured,
                inverse_std=np.full(3, seen * weight),
                nodes=nodes.astype(np.int32),
                weights=bodies.at(k, point[None])[0],
            ),
            EffectorRow(
                name=self.name,
                quantity="turn",
                unit="rad",
                measured=np.zeros(3) if seen else np.full(3, np.nan),
                inverse_std=np.full(3, seen * weight_angle),
                about=(k, 0),
                reference=reference,
            ),
        )

    def measured_as(
        self, values: Float[HostArray, "k 3"], mechanism: Mechanism
    ) -> "BodyFrame":
        """Replace the measured position [m] and rotation vector from rest [rad]."""
        k = mechanism.bodies.names.index(self.body)
        point = mechanism.bodies.origin[k] if self.point is None else self.point
        return replace(self, measured=Pose(values[0] - point, values[1]))


class Centroid(AbstractVector):
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
        converter=optional_point, default=None
    )
    std: float = 1e-3

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        """Return its position."""
        del mechanism
        nodes = node_indices(mesh, self.where, f"effector {self.name!r}")
        row = EffectorRow(
            name=self.name,
            quantity="point",
            unit="m",
            nodes=nodes.astype(np.int32),
            weights=np.full(nodes.size, 1.0 / nodes.size),
        )
        return vector_rows(row, self.measured, self.std)


class BodyAngle(AbstractScalar):
    """Angle by which one rigid body has turned against another.

    Attributes:
        name: Its name.
        body: The body that turns.
        other: The body it is measured from.
        axis: Axis of the angle, fixed to `other`, as it lies at rest [-].
        measured: Measured angle from rest [rad].
        std: Its standard deviation [rad].
    """

    name: str
    body: str
    other: str
    axis: Float[HostArray, "3"] = eqx.field(converter=_point)
    measured: float | None = None
    std: float = 1e-2

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        """Return its single coordinate."""
        del mesh
        names = mechanism.bodies.names
        pair = (
            index_of(self.body, names, "rigid body", self.name),
            index_of(self.other, names, "rigid body", self.name),
        )
        length = np.linalg.norm(self.axis)
        if self.axis.shape != (3,) or not (np.isfinite(length) and length > 0.0):
            raise ValueError(
                f"axis of effector {self.name!r} must be three finite numbers, not all "
                f"zero, got {self.axis}."
            )
        axis = self.axis / length
        row = EffectorRow(self.name, "scalar", "rad", about=pair, axis=axis)
        return scalar_rows(row, self.measured, self.std)
