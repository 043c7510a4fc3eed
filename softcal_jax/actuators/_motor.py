"""Motors: a torque that turns a rigid body."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.actuators._actuator import AbstractActuator, Kind, RestState
from softcal_jax.actuators._cliques import (
    AbstractPotentialCliques,
    ActuatorGeometry,
    unit,
)


class Motor(AbstractActuator):
    """A torque that turns a rigid body about the third axis of its frame at rest.

    delta_a is the angle of its first axis, projected on the plane of the first two axes
    at rest [rad], in (-pi, pi]; lambda_a is the torque [N m]. The angle is undefined if
    a body that is free to tilt turns its first axis normal to that plane.

    Attributes:
        name: Its name.
        body: Name of the rigid body.
    """

    name: str
    body: str
    kind: ClassVar[Kind] = Kind("motor", "N m", "rad")

    def cliques(self, rest: RestState, owner: int) -> "MotorFrames":
        """Return the frame of the body."""
        nodes = rest.frame_nodes(self.body, self.label)
        origin, first, second, _ = rest.points[nodes]
        plane = jnp.asarray([[first - origin, second - origin]])
        return MotorFrames(
            jnp.asarray(nodes[None]), jnp.full(1, owner, nodes.dtype), plane
        )


class MotorFrames(AbstractPotentialCliques):
    """Frames of driven bodies, four nodes each; each adds its angle to delta_a.

    Attributes:
        plane: First and second axis at rest, of equal length [m].
    """

    plane: Float[Array, "*cliques 2 3"]

    def contribution(self, x: Float[Array, "4 3"]) -> Float[Array, ""]:
        """Compute the angle of the first axis of one frame [rad]."""
        along, across = self.plane @ (x[1] - x[0])
        return jnp.arctan2(across, along)

    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        """Draw origin and axis of the frames."""
        nodes, owner = np.asarray(self.nodes), np.asarray(self.owner)
        origin, axis_end = x[nodes[:, 0]], x[nodes[:, 3]]
        arrows = unit(axis_end - origin)
        return ActuatorGeometry(points=origin, arrows=arrows, point_owner=owner)
