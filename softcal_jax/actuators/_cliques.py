"""Cliques: small sets of nodes whose contributions add up to an actuator.

A cable segment, a face of a chamber, the frame of a motor: each is one clique.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, TypeVar

import equinox as eqx
import jax
import numpy as np

from softcal_jax._module import Module, one_line
from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.mesh import Refinement

T = TypeVar("T", bound="AbstractCliques")


class ActuatorGeometry(NamedTuple):
    """What to draw of actuators, each with the index of its actuator, the owner.

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

    __repr__ = one_line


class AbstractCliques(Module):
    """All cliques of one type, and the forces on their nodes.

    Arrays hold all cliques along their first axis; methods see a single clique, under
    the `vmap` of `each_clique`.

    Attributes:
        nodes: Nodes of the cliques, one that repeats within a clique as padding.
        owner: Index of the actuator that each belongs to.
        curved: Whether the force depends on the positions of the nodes.
    """

    nodes: Int[Array, "*cliques m"]
    owner: Int[Array, "*cliques"]
    curved: ClassVar[bool] = True

    @abstractmethod
    def row(self, x: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
        """Force on the nodes of one clique at the positions `x`, for lambda_a = 1."""

    @abstractmethod
    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        """Collect what to draw of all cliques at the positions of all nodes [m]."""

    def refined(self, refinement: Refinement) -> "AbstractCliques":
        """Return the cliques on a finer mesh; here for nodes of frames of bodies."""
        nodes = refinement.nodes(np.asarray(self.nodes))
        return eqx.tree_at(lambda c: c.nodes, self, jax.device_put(nodes))

    def curvature(self, x: Float[Array, "m 3"]) -> Float[Array, "3*m 3*m"]:
        """Differentiate the force by the positions, node by node, for lambda_a = 1."""
        return jax.jacfwd(self.row)(x).reshape(x.size, x.size)


class AbstractDisplacedCliques(AbstractCliques):
    """Cliques with a displacement, whatever their force."""

    @abstractmethod
    def contribution(self, x: Float[Array, "m 3"]) -> Float[Array, ""]:
        """Compute what one clique adds to delta_a, up to a constant."""

    def displacement_row(self, x: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
        return jax.grad(self.contribution)(x)


class AbstractPotentialCliques(AbstractDisplacedCliques):
    """Cliques whose force is the gradient of their part of delta_a."""

    def row(self, x: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
        return self.displacement_row(x)


def each_clique(
    method: Callable[[Any, Array], Array],
    cliques: AbstractCliques,
    x: Float[Array, "n_all 3"],
) -> Float[Array, "n_cliques ..."]:
    """Call a method of every clique with the positions of its own nodes."""
    return jax.vmap(method)(cliques, x[cliques.nodes])


def owned(nodes: HostArray, owner: int) -> tuple[Array, Array]:
    """Return nodes and owner of the cliques of one actuator."""
    # Not jnp.asarray, which would compile a program for every shape.
    return jax.device_put((nodes, np.full(len(nodes), owner, nodes.dtype)))


def on_finer_faces(cliques: T, refinement: Refinement) -> T:
    """Return cliques that are faces on the faces that each of them becomes."""
    nodes = refinement.faces(np.asarray(cliques.nodes))
    each = lambda a: np.repeat(np.asarray(a), len(nodes) // len(a), axis=0)
    many = jax.tree.map(each, cliques)
    return jax.device_put(eqx.tree_at(lambda c: c.nodes, many, nodes))


class AbstractPressedFaces(AbstractCliques):
    """Faces on which a pressure acts."""

    def refined(self, refinement: Refinement) -> "AbstractPressedFaces":
        return on_finer_faces(self, refinement)

    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        nodes, owner = np.asarray(self.nodes), np.asarray(self.owner)
        return ActuatorGeometry(faces=nodes, face_owner=owner)


def unit(v: Float[HostArray, "n 3"]) -> Float[HostArray, "n 3"]:
    """Normalise vectors [-]."""
    return v / np.linalg.norm(v, axis=1, keepdims=True)
