"""Actuators, and those that push or turn at one place: forces and motors."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module, key
from softcal_jax._text import check_known
from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.bodies import as_floats, three_numbers, unit_vector
from softcal_jax.mesh import TetMesh, face_shares, locate


class ActuatorGeometry(NamedTuple):
    """What to draw of actuators; the owner of each part is the index of its actuator.

    Attributes:
        segments: Ends of the segments of cables [m].
        faces: Nodes of the faces of chambers and surface pressures.
        points: Mean point of action of a force, or origin of a motor's frame [m].
        arrows: Direction of that force, or axis of that motor [-].
    """

    segments: Float[HostArray, "n_segments 2 3"] = np.zeros((0, 2, 3))
    segment_owner: Int[HostArray, " n_segments"] = np.zeros(0, np.int32)
    faces: Int[HostArray, "n_faces n_fn"] = np.zeros((0, 3), np.int32)
    face_owner: Int[HostArray, " n_faces"] = np.zeros(0, np.int32)
    points: Float[HostArray, "n_markers 3"] = np.zeros((0, 3))
    arrows: Float[HostArray, "n_markers 3"] = np.zeros((0, 3))
    point_owner: Int[HostArray, " n_markers"] = np.zeros(0, np.int32)


class AbstractCliques(Module):
    """All cliques of one type, and the forces on their nodes.

    Arrays hold all cliques along their first axis; methods see a single clique, under
    the `vmap` of `each_clique`.

    Attributes:
        nodes: Nodes of the cliques; one that repeats within a clique is padding.
        owner: Index of the actuator that each clique belongs to.
        curved: Whether the force depends on the positions of the nodes.
        conservative: Whether the force is the gradient of their part of delta_a.
    """

    nodes: Int[Array, "*cliques m"]
    owner: Int[Array, "*cliques"]
    curved: ClassVar[bool] = True
    conservative: ClassVar[bool] = False

    @abstractmethod
    def row(self, x: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
        """Force on the nodes of one clique at the positions `x`, for lambda_a = 1."""

    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        """Collect what to draw at the positions of all nodes [m]: faces by default."""
        nodes, owner = np.asarray(self.nodes), np.asarray(self.owner)
        return ActuatorGeometry(faces=nodes, face_owner=owner)

    def following(self, mesh: TetMesh, n_actuators: int) -> "AbstractCliques":
        """Return the cliques on a mesh with other points; what it carries follows."""
        del mesh, n_actuators
        return self

    def curvature(self, x: Float[Array, "m 3"]) -> Float[Array, "3*m 3*m"]:
        """Differentiate the force by the positions, node by node, for lambda_a = 1."""
        return jax.jacfwd(self.row)(x).reshape(x.size, x.size)


class AbstractDisplacedCliques(AbstractCliques):
    """Cliques with a displacement, whose gradient is their force unless they say so."""

    conservative: ClassVar[bool] = True

    @abstractmethod
    def contribution(self, x: Float[Array, "m 3"]) -> Float[Array, ""]:
        """Compute what one clique adds to delta_a, up to a constant."""

    def displacement_row(self, x: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
        return jax.grad(self.contribution)(x)

    def row(self, x: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
        return self.displacement_row(x)


def each_clique(
    method: Callable[[Any, Array], Array],
    cliques: AbstractCliques,
    x: Float[Array, "n_all 3"],
) -> Float[Array, "n_cliques ..."]:
    """Call a method of every clique with the positions of its own nodes."""
    return jax.vmap(method)(cliques, x[cliques.nodes])


def owned(nodes: HostArray, owner: int, *more: HostArray) -> tuple[Array, ...]:
    """Return the arrays of the cliques of one actuator: nodes, owner and others."""
    # Not jnp.asarray, which would compile a program for every shape.
    return jax.device_put((nodes, np.full(len(nodes), owner, nodes.dtype), *more))


SURFACE = key(words='name of a surface group: "z_max"')

OUTSIDE = 1e-3
"""Distance by which a point may lie outside the mesh, relative to its size [-]."""


class Kind(NamedTuple):
    """Name of a kind of actuator in messages, and its units.

    Some have no displacement. lambda_a of a `unilateral` kind must not be negative.
    What may be `imposed` is in the words of a project file, with an example of each.
    """

    noun: str
    force_unit: str
    displacement_unit: str | None
    unilateral: bool = False
    imposed: str = 'its force, like "2 N", or its displacement, like "5 mm"'

    @property
    def force(self) -> str:
        """What lambda_a is called."""
        return "pressure" if self.force_unit == "Pa" else "force"


class RestState(Module):
    """The mesh and the rigid bodies at rest, to which actuators are attached.

    `points` are the nodes of the mesh, then four nodes for each rigid body k, from
    n_nodes + 4 k on: the origin of its frame and the ends of its three axes [m].
    `bodies` has the index k of each rigid body.
    """

    mesh: TetMesh
    points: Float[HostArray, "n_all 3"]
    bodies: Mapping[str, int]

    def frame_nodes(self, body: str, owner: str) -> Int[HostArray, "4"]:
        check_known(f"rigid body of {owner}", self.bodies, body)
        return self.mesh.n_nodes + 4 * self.bodies[body] + np.arange(4, dtype=np.int32)

    def on_mesh(
        self, point: Float[HostArray, "3"], owner: str
    ) -> tuple[Int[HostArray, " n_en"], Float[HostArray, " n_en"]]:
        """Return the nodes and weights [-] that carry a material point of the mesh."""
        near, names = OUTSIDE * self.mesh.size, [f"the point of {owner}"]
        place = locate(self.mesh, point[None], max_distance=near, names=names)
        return place.nodes[0], place.weights[0]

    def on_body(
        self, point: Float[HostArray, "3"], body: str, owner: str
    ) -> tuple[Int[HostArray, "4"], Float[HostArray, "4"]]:
        """Return the frame nodes and weights [-] that carry a point of a rigid body.

        Affine weights: x = x_0 + sum_i w_i (x_i - x_0), exact under rigid motion.
        """
        nodes = self.frame_nodes(body, owner)
        origin, *ends = self.points[nodes]
        along = np.linalg.solve((np.stack(ends) - origin).T, point - origin)
        return nodes, np.concatenate([[1.0 - along.sum()], along])


class AbstractActuator(Module):
    """A part of the robot that drives it with a force lambda_a.

    If it has a displacement delta_a(x), zero at rest, that may be imposed or measured,
    and H_a = d delta_a / dx. F_a, the force on the nodes for lambda_a = 1, equals H_a
    if the actuator has a potential.
    """

    name: str
    kind: ClassVar[Kind]

    def __check_init__(self):
        if not self.name:
            raise ValueError(f"a {self.kind.noun} needs a name that is not empty.")

    @property
    def label(self) -> str:
        """Kind and name in messages, like "cable 'left'"."""
        return f"{self.kind.noun} {self.name!r}"

    @abstractmethod
    def cliques(self, rest: RestState, owner: int) -> tuple[AbstractCliques, ...]:
        """Attach the actuator, the one with the index `owner`, to sets of nodes.

        Raises:
            ValueError: If it does not fit the mesh or the rigid bodies.
        """


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


class WeightedNodes(AbstractDisplacedCliques):
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


class MotorFrames(AbstractDisplacedCliques):
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
