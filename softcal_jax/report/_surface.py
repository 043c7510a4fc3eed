"""The surface of a body as the view of a page draws it: triangles, edges, walls."""

from typing import NamedTuple

import numpy as np

from softcal_jax._module import one_line
from softcal_jax._typing import Bool, HostArray, Int
from softcal_jax.equilibrium import Model
from softcal_jax.mesh import Tessellation, TetMesh, boundary_tets, tessellate

_SHARP = np.cos(np.radians(30.0))
"""Cosine of the angle between two triangles above which their edge is not sharp."""


class Surface(NamedTuple):
    """Triangles of the boundary and the edges of its faces.

    Attributes:
        cut: The triangles, face by face.
        per_face: How many triangles a face is cut into.
        faces: Nodes of each face.
        tets: The tet of each face.
        rigid: Whether all nodes of a face belong to one rigid body.
        edges: Points at the ends of the parts of the edges, the sharp ones first.
        n_sharp: How many of these are sharp at rest.
    """

    cut: Tessellation
    per_face: int
    faces: Int[HostArray, "n_faces n_fn"]
    tets: Int[HostArray, " n_faces"]
    rigid: Bool[HostArray, " n_faces"]
    edges: Int[HostArray, "n_edges 2"]
    n_sharp: int

    __repr__ = one_line

    def having(self, corners: Int[HostArray, "n 3"]) -> Bool[HostArray, " n_faces"]:
        """Say which faces have one of these triples of corners, in any order."""
        own = np.sort(self.faces[:, :3], axis=1)
        wanted = {tuple(row) for row in np.sort(corners, axis=1).tolist()}
        return np.array([tuple(row) in wanted for row in own.tolist()], bool)


def surface_of(model: Model, parts: int) -> Surface:
    """Cut the boundary into triangles.

    Args:
        model: The model.
        parts: Number of parts of every edge of a quadratic face.
    """
    tets = boundary_tets(model.mesh)
    cut = tessellate(model.mesh, parts=parts)
    per_face = len(cut.triangles) // len(tets)
    faces = cut.faces[::per_face]
    bodies, body = model.mechanism.bodies, np.full(model.mesh.n_nodes, -1)
    body[bodies.attached] = bodies.body
    own = body[faces]
    rigid = (own[:, 0] >= 0) & np.all(own == own[:, :1], axis=1)
    edges, sharp = _edges(model.mesh, cut, per_face)
    edges = np.concatenate([edges[sharp], edges[~sharp]])
    return Surface(cut, per_face, faces, tets, rigid, edges, int(sharp.sum()))


def _edges(
    mesh: TetMesh, cut: Tessellation, per_face: int
) -> tuple[Int[HostArray, "n_edges 2"], Bool[HostArray, " n_edges"]]:
    """Find the sides of triangles on edges of faces, and which are sharp at rest."""
    corners = cut.interpolate(mesh.points)[cut.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    sides = np.sort(cut.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(cut.triangles)), 3)
    order = np.lexsort(sides.T)
    sides, owner = sides[order], owner[order]
    first = np.flatnonzero(np.any(np.diff(sides, axis=0, prepend=-1) != 0, axis=1))
    count = np.diff(first, append=len(sides))
    paired = count == 2
    a, b = owner[first], owner[first + paired]
    within = paired & (a // per_face == b // per_face)
    # Where other than two triangles meet, bodies touch: a line worth seeing.
    sharp = ~paired | (np.einsum("ij,ij->i", normals[a], normals[b]) < _SHARP)
    return sides[first[~within]], sharp[~within]
