"""The boundary as flat triangles, for pictures and formats without curved faces.

VTK's surface filter cuts the same triangles, with points in single precision, but does
not return the weights by which they follow the nodes.
"""

from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.elements import shape_functions
from softcal_jax.mesh._tet_mesh import TetMesh
from softcal_jax.mesh._topology import boundary_faces

PARTS = 4
"""Number of parts of every edge of a quadratic face."""


class Tessellation(NamedTuple):
    """Triangles on the boundary, and the interpolation of nodal values to them.

    Each point has the nodes of the face that it lies on, and their shape functions as
    weights. Triangles have outward normals; `faces` holds the nodes of each one's face.
    """

    nodes: Int[HostArray, "n_points n_fn"]
    weights: Float[HostArray, "n_points n_fn"]
    triangles: Int[HostArray, "n_triangles 3"]
    faces: Int[HostArray, "n_triangles n_fn"]

    def interpolate(
        self, values: Float[HostArray, "n_nodes 3"]
    ) -> Float[HostArray, "n_points 3"]:
        """Interpolate nodal vectors to the points."""
        return np.einsum("pn,pni->pi", self.weights, values[self.nodes])


def tessellate(mesh: TetMesh, *, parts: int = PARTS) -> Tessellation:
    """Cut quadratic boundary faces into triangles that share their points.

    The triangles of a face follow each other, in the order of `boundary_faces`. Linear
    faces stay whole; each edge of a quadratic face is cut into `parts` pieces.
    """
    faces = boundary_faces(mesh)
    parts = parts if mesh.order == 2 else 1
    grid = np.array(
        [(parts - i - j, i, j) for j in range(parts + 1) for i in range(parts + 1 - j)]
    )
    weights = shape_functions(grid / parts, faces.shape[1])
    # Two faces share a point if it has the same weights at the same corners. This is
    # exact, whereas comparing coordinates would need a tolerance.
    corner = np.where(grid > 0, faces[:, None, :3], -1)
    weight = np.broadcast_to(grid, corner.shape)
    order = np.argsort(corner, axis=-1)
    key = np.concatenate(
        [np.take_along_axis(a, order, axis=-1) for a in (corner, weight)], axis=-1
    )
    _, first, point = np.unique(
        key.reshape(-1, 6), axis=0, return_index=True, return_inverse=True
    )
    face, local = np.divmod(first, len(grid))
    points = point.reshape(len(faces), len(grid))
    cut = points[:, _triangles(grid)]
    return Tessellation(
        faces[face],
        weights[local],
        cut.reshape(-1, 3),
        np.repeat(faces, cut.shape[1], axis=0),
    )


def _triangles(grid: Int[HostArray, "n_grid 3"]) -> Int[HostArray, "n_local 3"]:
    """List the triangles between the grid points of one face."""
    index = {(int(i), int(j)): k for k, (_, i, j) in enumerate(grid)}
    triangles = []
    for i, j in index:
        upright = ((i, j), (i + 1, j), (i, j + 1))
        turned = ((i + 1, j), (i + 1, j + 1), (i, j + 1))
        triangles += [
            [index[c] for c in corners]
            for corners in (upright, turned)
            if all(c in index for c in corners)
        ]
    return np.array(triangles)
