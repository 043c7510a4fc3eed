"""Motors: a torque that turns a rigid body."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.actuators._actuator import AbstractActuator, Kind, RestState
from softcal_jax.actuators._cliques import AbstractPotentialCliques
from softcal_jax.actuators._geometry import ActuatorGeometry, unit


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
        """Return the frame of the body.

        Raises:
            ValueError: If no rigid body has the name.
        """
        nodes = rest.frame_nodes(self.body, self.label)
        origin, first, second, _ = rest.points[nodes]
        return MotorFrames(
            jnp.asarray(nodes[None]),
            jnp.full(1, owner, nodes.dtype),
            jnp.asarray([[first - origin, second - origin]]),
        )


class MotorFrames(AbstractPotentialCliques):
    """Frames of driven bodies; each adds its angle to delta_a.

    Attributes:
        nodes: The four nodes of each frame.
        owner: Index of the motor.
        plane: First and second axis at rest, of equal length [m].
    """

    nodes: Int[Array, "*cliques 4"]
    owner: Int[Array, "*cliques"]
    plane: Float[Array, "*cliques 2 3"]
    curved: ClassVar[bool] = True

    def contribution(self, x: Float[Array, "4 3"]) -> Float[Array, ""]:
        """Compute the angle of the first axis of one frame [rad]."""
        along, across = self.plane @ (x[1] - x[0])
        return jnp.arctan2(across, along)

    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        """Origin and axis of the frames."""
        nodes = np.asarray(self.nodes)
        origin, axis_end = x[nodes[:, 0]], x[nodes[:, 3]]
        return ActuatorGeometry(
            points=origin,
            arrows=unit(axis_end - origin),
            point_owner=np.asarray(self.owner),
        )
