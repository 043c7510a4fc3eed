"""Refinement of a mesh, for references on finer ones.

A quadratic tet is split into eight through its mid nodes: four at its corners, and the
octahedron between them along its shortest diagonal (Bey, Computing 55, 1995).
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from softcal_jax.elements import TET_EDGES, shape_functions
from softcal_jax.mesh import TetMesh, to_quadratic

_AT_CORNERS = ((0, 4, 6, 7), (4, 1, 5, 8), (6, 5, 2, 9), (7, 8, 9, 3))

_AROUND = {(4, 9): (5, 6, 7, 8), (5, 7): (4, 8, 9, 6), (6, 8): (4, 5, 9, 7)}
"""Nodes of the octahedron around each of its diagonals, in their order."""

_CHILDREN = np.array(
    [
        [*_AT_CORNERS, *((*ends, ring[k - 1], ring[k]) for k in range(4))]
        for ends, ring in _AROUND.items()
    ]
)
"""Nodes of the eight tets, by the diagonal."""

_FACES = np.array([(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)])
"""Nodes of the four triangles of a quadratic one."""

_CORNERS = np.vstack([np.eye(4), np.eye(4)[np.array(TET_EDGES)].mean(axis=1)])
"""Barycentric coordinates of the nodes of a quadratic tet [-]."""


def refine(mesh: TetMesh) -> TetMesh:
    """Split each tet into eight of the same order, with the same groups.

    Nodes keep their indices, and the tets of each come one after the other. New nodes
    of quadratic tets lie on their sides, so curved ones stay so. Node groups grow as in
    `to_quadratic`.
    """
    if mesh.order == 1:
        return _split(to_quadratic(mesh))[0]
    linear, local = _split(mesh)
    fine = to_quadratic(linear)
    mids = _CORNERS[local][:, np.array(TET_EDGES)].mean(axis=2)
    parents = mesh.points[np.repeat(mesh.tets, 8, axis=0)]
    points = fine.points.copy()
    points[fine.tets[:, 4:]] = shape_functions(mids, 10) @ parents
    return replace(fine, points=points)


def _split(mesh: TetMesh) -> tuple[TetMesh, Int[np.ndarray, "n_finer_tets 4"]]:
    """Split quadratic tets into eight linear ones, and return their local nodes."""
    ends = mesh.points[mesh.tets[:, np.array(list(_AROUND))]]
    lengths = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
    local = _CHILDREN[np.argmin(lengths, axis=1)]
    tets = np.take_along_axis(mesh.tets[:, None], local, axis=2).reshape(-1, 4)
    children = lambda parents: (8 * parents[:, None] + np.arange(8)).ravel()
    linear = TetMesh(
        mesh.points,
        tets,
        mesh.node_groups,
        {n: f[:, _FACES].reshape(-1, 3) for n, f in mesh.surface_groups.items()},
        {name: children(group) for name, group in mesh.tet_groups.items()},
    )
    return linear, local.reshape(-1, 4)
