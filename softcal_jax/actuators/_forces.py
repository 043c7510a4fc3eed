"""Forces of fixed direction, at a point or over a surface; torques of motors."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import key
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.actuators._actuator import (
    SURFACE,
    AbstractActuator,
    AbstractPotentialCliques,
    ActuatorGeometry,
    Kind,
    RestState,
    owned,
)
from softcal_jax.bodies import as_floats, three_numbers, unit_vector
from softcal_jax.mesh import TetMesh, face_shares

DIRECTION = key("", 'direction of a positive force: "-z", or [0, 0, -1]')


class ForceActuator(AbstractActuator):
    """A force of fixed direction at a material point of the mesh or of a rigid body.

    delta_a = d . (x_point - X_point) with d the unit direction [m]; lambda_a is the
    force [N].

    Attributes:
        point: Its point of action at rest, on or in the mesh, or fixed to the body [m].
        direction: Direction of a positive force, of any length.
        body: The rigid body that it pushes, like a probe; by default it acts on the
            mesh.
    """

    point: Float[HostArray, "3"] = eqx.field(
        converter=as_floats, metadata=key("m", 'where it acts: "(50, 10, 0) mm"')
    )
    direction: Float[HostArray, "3"] = eqx.field(
        converter=as_floats, metadata=DIRECTION
    )
    body: str | None = None
    kind: ClassVar[Kind] = Kind("force actuator", "N", "m")

    def __check_init__(self):
        three_numbers(f"{self.label}: point", "m", self.point)
        unit_vector(f"{self.label}: direction", self.direction)

    def cliques(self, rest: RestState, owner: int) -> "tuple[WeightedNodes]":
        if self.body is None:
            nodes, weights = rest.on_mesh(self.point, self.label)
        else:
            nodes, weights = rest.on_body(self.point, self.body, self.label)
        parts = weights[None, :, None] * unit_vector("direction", self.direction)
        return (WeightedNodes(*owned(nodes[None], owner, parts)),)


class SurfaceForceActuator(AbstractActuator):
    """A force of fixed direction, spread evenly over a surface by its area at rest.

    delta_a = d . (mean displacement of the surface) [m], with d the unit direction and
    the mean weighted by area at rest; lambda_a is the total force [N].

    Attributes:
        surface: Name of a surface group.
        direction: Direction of a positive force, of any length.
    """

    surface: str = eqx.field(metadata=SURFACE)
    direction: Float[HostArray, "3"] = eqx.field(
        converter=as_floats, metadata=DIRECTION
    )
    kind: ClassVar[Kind] = Kind("surface force actuator", "N", "m")

    def __check_init__(self):
        unit_vector(f"{self.label}: direction", self.direction)

    def cliques(self, rest: RestState, owner: int) -> "tuple[WeightedNodes]":
        faces = rest.mesh.faces(self.surface)
        shares = face_shares(rest.mesh, faces)
        weights = (shares / shares.sum())[..., None]
        parts = weights * unit_vector("direction", self.direction)
        return (WeightedNodes(*owned(faces, owner, parts), by_area=True),)


class WeightedNodes(AbstractPotentialCliques):
    """Nodes of tets or faces whose positions, by `weights` [-], add up to delta_a.

    Those `by_area` are the shares of faces in the area at rest of all of an actuator.
    """

    weights: Float[Array, "*cliques m 3"]
    by_area: bool = eqx.field(static=True, default=False, kw_only=True)
    curved: ClassVar[bool] = False

    def contribution(self, x: Float[Array, "m 3"]) -> Float[Array, ""]:
        return jnp.sum(self.weights * x)

    def following(self, mesh: TetMesh, n_actuators: int) -> "WeightedNodes":
        if not self.by_area:
            return self
        old, shares = jnp.sum(self.weights, axis=1), face_shares(mesh, self.nodes)
        direction = old / jnp.linalg.norm(old, axis=1, keepdims=True)
        total = jax.ops.segment_sum(jnp.sum(shares, axis=1), self.owner, n_actuators)
        weights = (shares / total[self.owner][:, None])[..., None] * direction[:, None]
        return eqx.tree_at(lambda nodes: nodes.weights, self, weights)

    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        """Draw one arrow per actuator at the mean point of action of its force."""
        nodes = np.asarray(self.nodes).ravel()
        weights = np.asarray(self.weights).reshape(-1, 3)
        owner = np.repeat(np.asarray(self.owner), self.nodes.shape[1])
        actuators, of = np.unique(owner, return_inverse=True)
        total = np.zeros((actuators.size, 3))
        np.add.at(total, of, weights)
        arrows = _unit(total)
        points = np.zeros_like(total)
        np.add.at(points, of, np.sum(weights * arrows[of], axis=1)[:, None] * x[nodes])
        return ActuatorGeometry(points=points, arrows=arrows, point_owner=actuators)


class Motor(AbstractActuator):
    """A torque that turns a rigid body about the third axis of its frame at rest.

    delta_a is the angle of its first axis, projected on the plane of the first two axes
    at rest [rad], in (-pi, pi]; lambda_a is the torque [N m]. The angle is undefined if
    a body that is free to tilt turns its first axis normal to that plane.

    Attributes:
        body: Name of the rigid body.
    """

    body: str = eqx.field(
        metadata=key(words='the rigid body that it turns, with a hinge: "arm"')
    )
    kind: ClassVar[Kind] = Kind(
        "motor",
        "N m",
        "rad",
        imposed='its torque, like "50 N*mm", or its angle, like "30 deg"',
    )

    def cliques(self, rest: RestState, owner: int) -> "tuple[MotorFrames]":
        nodes = rest.frame_nodes(self.body, self.label)
        origin, first, second, _ = rest.points[nodes]
        plane = np.array([[first - origin, second - origin]])
        return (MotorFrames(*owned(nodes[None], owner, plane)),)


class MotorFrames(AbstractPotentialCliques):
    """Frames of driven bodies, four nodes each; each adds its angle to delta_a.

    The `plane` holds first and second axis at rest, of equal length [m].
    """

    plane: Float[Array, "*cliques 2 3"]

    def contribution(self, x: Float[Array, "4 3"]) -> Float[Array, ""]:
        along, across = self.plane @ (x[1] - x[0])
        return jnp.arctan2(across, along)

    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        nodes, owner = np.asarray(self.nodes), np.asarray(self.owner)
        origin, axis_end = x[nodes[:, 0]], x[nodes[:, 3]]
        arrows = _unit(axis_end - origin)
        return ActuatorGeometry(points=origin, arrows=arrows, point_owner=owner)


def _unit(v: Float[HostArray, "n 3"]) -> Float[HostArray, "n 3"]:
    """Normalise vectors [-]."""
    return v / np.linalg.norm(v, axis=1, keepdims=True)
