"""Dead loads: forces that keep their direction and size while the body deforms."""

from abc import abstractmethod

import equinox as eqx
import numpy as np

from softcal_jax._module import Module
from softcal_jax._names import UNNAMED_LOADS
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.bodies import three_numbers
from softcal_jax.mesh import (
    TetMesh,
    boundary_faces,
    locate,
    node_indices,
    surface_shares,
)


class AbstractLoad(Module):
    """A load that becomes forces on nodes, consistent with the shape functions.

    Loads of one name share a factor where they are only roughly known, see
    `load_factor`.
    """

    name: str = eqx.field(default=UNNAMED_LOADS, kw_only=True)

    @abstractmethod
    def nodal_forces(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        """Compute forces on all nodes [N].

        Raises:
            ValueError: If there is no such place, or a force is not finite.
        """


class PointForce(AbstractLoad):
    """Force at a material point of the body.

    Attributes:
        point: Where it acts at rest, on or in the mesh [m].
        force: The force [N].
    """

    point: tuple[float, float, float]
    force: tuple[float, float, float]

    def nodal_forces(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        point = three_numbers("point", "m", self.point)
        force = three_numbers("force", "N", self.force)
        near, names = 1e-3 * mesh.size, ["the point of the force"]
        place = locate(mesh, point[None], max_distance=near, names=names)
        return _added(mesh, place.nodes[0], place.weights[0][:, None] * force)


class NodalForces(AbstractLoad):
    """Forces on given nodes.

    Attributes:
        nodes: Node indices.
        forces: One force per node [N].
    """

    nodes: Int[HostArray, " n"]
    forces: Float[HostArray, "n 3"]

    def nodal_forces(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        nodes = node_indices(mesh, self.nodes, "a nodal force")
        forces = np.asarray(self.forces, float)
        if forces.shape != (len(nodes), 3):
            raise ValueError(
                f"{len(nodes)} nodes need forces of shape ({len(nodes)}, 3) [N], got "
                f"{forces.shape}."
            )
        for node, force in zip(nodes, forces, strict=True):
            if not np.all(np.isfinite(force)):
                raise ValueError(f"node {node} needs a finite force [N], got {force}.")
        return _added(mesh, nodes, forces)


class EdgeForce(AbstractLoad):
    """Force spread evenly over an edge of the body, by length.

    Attributes:
        where: Node group of the edge, or its node indices: all edges of boundary faces
            whose ends both belong to it are loaded.
        force: Total force [N].
    """

    where: str | Int[HostArray, " n"]
    force: tuple[float, float, float]

    def nodal_forces(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        """Share the force: 1/2, 1/2 on linear edges, 1/6, 1/6, 4/6 on quadratic [N]."""
        force = three_numbers("force", "N", self.force)
        nodes = node_indices(mesh, self.where, "an edge force")
        edges = _boundary_edges(mesh)
        edges = edges[np.all(np.isin(edges[:, :2], nodes), axis=1)]
        if len(edges) == 0:
            raise ValueError(
                f"no edge of the boundary has both ends in {self.where!r}: an edge "
                "force needs the nodes along an edge, at least two neighbours."
            )
        ends = mesh.points[edges[:, :2]]
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        shares = np.array([0.5, 0.5] if edges.shape[1] == 2 else [1 / 6, 1 / 6, 4 / 6])
        per_edge = (length / length.sum())[:, None] * shares
        return _added(mesh, edges, per_edge[:, :, None] * force)


class SurfaceForce(AbstractLoad):
    """Force spread evenly over a surface, by its area at rest.

    Attributes:
        where: Name of a surface group.
        force: Total force [N].
    """

    where: str
    force: tuple[float, float, float]

    def nodal_forces(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        shares = surface_shares(mesh, mesh.faces(self.where))
        force = three_numbers("force", "N", self.force)
        return (shares / shares.sum())[:, None] * force


class SurfaceTraction(AbstractLoad):
    """Force per area at rest, of fixed direction.

    Attributes:
        where: Name of a surface group.
        traction: Force per reference area [Pa].
    """

    where: str
    traction: tuple[float, float, float]

    def nodal_forces(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        shares = surface_shares(mesh, mesh.faces(self.where))
        return shares[:, None] * three_numbers("traction", "Pa", self.traction)


def _added(mesh: TetMesh, nodes, forces) -> Float[HostArray, "n_nodes 3"]:
    """Place forces on all nodes [N]; they add up where a node is named twice."""
    out = np.zeros_like(mesh.points)
    np.add.at(out, nodes, forces)
    return out


def _boundary_edges(mesh: TetMesh) -> Int[HostArray, "n_edges n_ln"]:
    """List edges of the boundary faces once: two ends, then the mid node if any."""
    faces = boundary_faces(mesh)
    sides = [(0, 1, 3), (1, 2, 4), (2, 0, 5)]
    n_ln = 2 if faces.shape[1] == 3 else 3
    edges = np.concatenate([faces[:, side[:n_ln]] for side in sides])
    edges[:, :2] = np.sort(edges[:, :2], axis=1)
    return np.unique(edges, axis=0)
