"""Effectors of actuators and supports: lengths, volumes, forces, reactions."""

import equinox as eqx
import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.bodies import BodyArrays
from softcal_jax.configurations._effector import (
    AbstractScalar,
    AbstractVector,
    EffectorRow,
    index_of,
    optional_point,
    scalar_rows,
    vector_rows,
)
from softcal_jax.configurations._mechanism import Mechanism
from softcal_jax.mesh import TetMesh, node_indices


class ActuatorDisplacement(AbstractScalar):
    """Displacement delta_a of an actuator: length of a cable, volume of a chamber.

    For a motor it is the reading of its encoder, as for `ImposedDisplacement`: the
    angle of its body minus the zero error. `BodyFrame` and `BodyAngle` give the angle
    itself.

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
        a = index_of(self.actuator, actuators.names, "actuator", self.name)
        unit = actuators.kinds[a].displacement_unit
        if unit is None:
            raise ValueError(
                f"effector {self.name!r}: {actuators.kinds[a].noun} {self.actuator!r} "
                "has no displacement; use ActuatorForce."
            )
        row = EffectorRow(self.name, "scalar", unit, about=(a, -1))
        return scalar_rows(row, self.measured, self.std)


class ActuatorForce(AbstractScalar):
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
        a = index_of(self.actuator, actuators.names, "actuator", self.name)
        unit = actuators.kinds[a].force_unit
        row = EffectorRow(self.name, "force", unit, about=(a, 0))
        return scalar_rows(row, self.measured, self.std)


class SupportReaction(AbstractVector):
    """Force with which the ground holds a group of nodes: a load cell under a clamp.

    A rigid body among them is held as a whole: the reaction includes its own mass, what
    pulls at it, and bodies that are tied to it.

    Attributes:
        name: Its name.
        where: The group, or node indices.
        measured: Measured force of the support on the body [N].
        std: Standard deviation of each coordinate [N].
    """

    name: str
    where: str | Int[HostArray, " n"]
    measured: Float[HostArray, "3"] | None = eqx.field(
        converter=optional_point, default=None
    )
    std: float = 1e-2

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        """Its three coordinates."""
        nodes = node_indices(mesh, self.where, f"effector {self.name!r}")
        nodes = _with_bodies(nodes, mesh, mechanism.bodies, self.name)
        ones = np.ones(nodes.size)
        row = EffectorRow(self.name, "reaction", "N", nodes=nodes, weights=ones)
        return vector_rows(row, self.measured, self.std)


def _with_bodies(
    nodes: Int[HostArray, " n"], mesh: TetMesh, bodies: BodyArrays, name: str
) -> Int[HostArray, " _"]:
    """Add, for bodies among the nodes, all nodes by which the ground holds them.

    These include the frame nodes of a body, on which masses and cables act.
    """
    inside = np.isin(bodies.attached, nodes)
    counts = [(inside[bodies.body == k], k) for k in range(bodies.n_bodies)]
    for own, k in counts:
        if own.any() and not own.all():
            raise ValueError(
                f"effector {name!r} names {own.sum()} of the {own.size} nodes of rigid "
                f"body {bodies.names[k]!r}, which is held as a whole: name all or none."
            )
    whole = [k for own, k in counts if own.all()]
    carried = [k for _, k in counts if k in whole or bodies.owner[k] in whole]
    frames = [mesh.n_nodes + 4 * k + np.arange(4) for k in carried]
    attached = bodies.attached[np.isin(bodies.body, carried)]
    return np.unique(np.concatenate([nodes, attached, *frames])).astype(np.int32)
