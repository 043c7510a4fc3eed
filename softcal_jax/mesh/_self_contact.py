"""Where a deformed body passes through itself."""

from itertools import chain

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from softcal_jax._module import Module
from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax._units import readable_values
from softcal_jax.elements import shape_functions
from softcal_jax.mesh._location import (
    INSIDE,
    barycentric_in_tets,
    barycentric_of,
    bezier_points,
)
from softcal_jax.mesh._selection import place
from softcal_jax.mesh._tet_mesh import TetMesh
from softcal_jax.mesh._topology import boundary_faces, tessellate

_LEAST = 1e-4
"""Depth that counts, over the size of the mesh [-]: less is within its error."""


class SelfContact(Module):
    """Where a deformed body passes through itself.

    Attributes:
        nodes: Nodes of the surface that lie inside the body elsewhere, the deepest
            first.
        depth: Depth below the surface, at rest, of the material in which each lies [m].
        where: The surface group of the deepest, else its position at rest, in words.
    """

    nodes: Int[HostArray, " n"]
    depth: Float[HostArray, " n"]
    where: str

    @property
    def words(self) -> str:
        """How deep and where, like "0.4 mm deep near (12, 3, 40) mm"."""
        depth = readable_values([float(self.depth[0])], "m", digits=2)
        return f"{depth} deep {self.where}"

    def _words(self) -> str:
        return self.words


def self_contact(
    mesh: TetMesh,
    displacement: Float[HostArray, "n_nodes 3"],
    *,
    carrier: Int[HostArray, " n_nodes"] | None = None,
    placed: Bool[HostArray, " n_nodes"] | None = None,
    within: Float[HostArray, " n_nodes"] | None = None,
) -> SelfContact | None:
    """Find nodes of the surface that a displacement [m] moves into the body elsewhere.

    Whether a node lies in a tet is decided by the map of the tet itself, so the faces
    of a quadratic tet are as curved as they are, and a gap that stays open, however
    thin, is no contact. Parts that overlap at rest count by how much farther they go.
    Parts that cannot move against each other, like blocks on one rigid body, do not.

    Not seen are overlaps that hold no node of the surface, such as two edges that cross
    between their nodes; those within two layers of tets around a node, as in the root
    of a closing notch; and those shallower than 1e-4 of the size of the mesh.

    Args:
        mesh: The mesh at rest.
        displacement: Displacement of its nodes [m].
        carrier: Number of the rigid body that moves each node, negative for none. A
            node does not touch tets that its own body moves, wholly or in part.
        placed: Whether the place of each node is imposed, as by a clamp. Such nodes do
            not touch what is between such nodes alone.
        within: Depth of each node that does not count [m].

    Returns:
        The nodes and their depths; None without any.
    """
    x, surface = mesh.points + displacement, np.unique(boundary_faces(mesh))
    node, tet, b = _inside(mesh, x, surface)
    N, moves = shape_functions(b, mesh.tets.shape[1]), np.ones(len(node), bool)
    if carrier is not None:
        together = (carrier[mesh.tets[tet]] == carrier[node, None]).any(axis=1)
        moves &= ~together | (carrier[node] < 0)
    if placed is not None:
        # On a face between what is placed and what deforms, only its nodes count.
        free = np.sum(np.abs(N) * ~placed[mesh.tets[tet]], axis=1)
        moves &= ~placed[node] | (free > INSIDE)
    node, tet, N = node[moves], tet[moves], N[moves]
    if not node.size:
        return None
    depth = _depth(mesh, np.einsum("na,nai->ni", N, mesh.points[mesh.tets[tet]]))
    least = np.zeros(mesh.n_nodes) if within is None else within
    counts = depth > np.maximum(_LEAST * mesh.size, least[node])
    node, depth = node[counts], depth[counts]
    order = np.argsort(-depth)
    if not order.size:
        return None
    # A node may lie on a face of two tets.
    _, first = np.unique(node[order], return_index=True)
    order = order[np.sort(first)]
    deepest = node[order[0]]
    names = [name for name, of in mesh.surface_groups.items() if deepest in of]
    where = names[0] if names else place(mesh.points[deepest])
    return SelfContact(node[order], depth[order], f"near {where}")


def _inside(
    mesh: TetMesh, x: Float[HostArray, "n_nodes 3"], nodes: Int[HostArray, " n"]
) -> tuple[HostArray, HostArray, HostArray]:
    """Find nodes in tets that are not near them in the mesh, and their coordinates."""
    hull = bezier_points(x[mesh.tets])
    lower, upper = hull.min(axis=1), hull.max(axis=1)
    centres, radii = (lower + upper) / 2.0, np.linalg.norm(upper - lower, axis=1) / 2.0
    tree = KDTree(x[nodes], leafsize=30)  # twice as fast here as with 10
    near = tree.query_ball_point(centres, radii, return_sorted=False)
    tet = np.repeat(np.arange(mesh.n_tets), [len(some) for some in near])
    node = nodes[np.fromiter(chain.from_iterable(near), int)]
    kept = (mesh.tets[tet] != node[:, None]).all(axis=1)
    tet, node = tet[kept], node[kept]

    # Few are left for Newton's method: in the affine coordinates of its corners, a
    # curved tet lies between the extremes of its Bezier points.
    inverse = np.linalg.inv(hull[:, 1:4] - hull[:, :1])
    least = barycentric_of((hull - hull[:, :1]) @ inverse).min(axis=1)
    b = barycentric_of(((x[node] - hull[tet, 0])[:, None] @ inverse[tet])[:, 0])
    kept = (b >= least[tet] - INSIDE).all(axis=1)
    tet, node = tet[kept], node[kept]
    b = barycentric_in_tets(x[mesh.tets[tet]], x[node])
    kept = (b >= -INSIDE).all(axis=1) & ~_neighbours(mesh, node, tet)
    return node[kept], tet[kept], b[kept]


def _neighbours(
    mesh: TetMesh, node: Int[HostArray, " n"], tet: Int[HostArray, " n"]
) -> Bool[HostArray, " n"]:
    """Return whether each tet shares a node with one of the tets of a node."""
    ends = np.arange(mesh.n_tets + 1) * mesh.tets.shape[1]
    every = np.ones(mesh.tets.size, bool)
    holds = csr_array((every, mesh.tets.ravel(), ends), (mesh.n_tets, mesh.n_nodes))
    around = holds.T[node] @ holds  # nodes of the tets of each node
    return np.asarray(around.multiply(holds[tet]).sum(axis=1)) > 0


def _depth(mesh: TetMesh, points: Float[HostArray, "n 3"]) -> Float[HostArray, " n"]:
    """Compute distances from the surface at rest, its faces cut into triangles."""
    # Imported here, so that a body without contact does not wait for it.
    import pyvista

    cut = tessellate(mesh)
    X = cut.interpolate(mesh.points)
    surface = pyvista.PolyData.from_regular_faces(X, cut.triangles)
    cloud = pyvista.PolyData(points).compute_implicit_distance(surface)
    return np.abs(np.asarray(cloud["implicit_distance"]))
