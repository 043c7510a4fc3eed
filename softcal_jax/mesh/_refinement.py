"""Refinement of a mesh, and what moves its nodes, faces and values to the finer one.

A quadratic tet is split into eight through its mid nodes: four at its corners, and the
octahedron between them along its shortest diagonal (Bey, Computing 55, 1995).
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Shaped

from softcal_jax._module import one_line
from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.elements import TET_EDGES, shape_functions
from softcal_jax.mesh._conversion import MidNodes, to_quadratic
from softcal_jax.mesh._tet_mesh import TetMesh

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

_LINEAR = np.eye(4)
_QUADRATIC = np.vstack([_LINEAR, _LINEAR[np.array(TET_EDGES)].mean(axis=1)])
"""Barycentric coordinates of the nodes of a tet [-]."""


def refine(mesh: TetMesh) -> TetMesh:
    """Split each tet into eight of the same order, with the same groups.

    Nodes keep their indices, and the tets of each come one after the other. New nodes
    of quadratic tets lie on their sides, so curved ones stay so. Node groups grow as in
    `to_quadratic`.
    """
    if mesh.order == 1:
        return _split(to_quadratic(mesh))[0]
    return finer(mesh).mesh


class Refinement(NamedTuple):
    """A finer mesh whose displacements include those of the coarse one.

    Attributes:
        coarse: The mesh that is refined.
        linear: The tets of the finer mesh by their corners, which are nodes of the
            coarse mesh.
        mesh: The finer mesh, see `finer`. Nodes keep their indices, and new ones
            follow.
        corners: Barycentric coordinates of the corners of each tet in its parent [-].
        carriers: Nodes of the coarse mesh that move each new node.
        weights: Their shape functions there [-].
    """

    coarse: TetMesh
    linear: TetMesh
    mesh: TetMesh
    corners: Float[HostArray, "n_finer_tets 4 4"]
    carriers: Int[HostArray, "n_new n_en"]
    weights: Float[HostArray, "n_new n_en"]

    __repr__ = one_line

    @property
    def n_new(self) -> int:
        """Number of new nodes."""
        return len(self.carriers)

    @property
    def parent(self) -> Int[HostArray, " n_finer_tets"]:
        """Index of the tet that each is part of."""
        n_children = self.mesh.n_tets // self.coarse.n_tets
        return np.repeat(np.arange(self.coarse.n_tets), n_children)

    def nodes(self, indices: Int[HostArray, "..."]) -> Int[HostArray, "..."]:
        """Return the new indices of nodes; those of frames come after the new nodes."""
        after = indices >= self.coarse.n_nodes
        return np.where(after, indices + self.n_new, indices).astype(indices.dtype)

    def with_new(
        self,
        values: Shaped[HostArray, "n_all ..."],
        new: Shaped[HostArray, "n_new ..."],
    ) -> Shaped[HostArray, "n_finer_all ..."]:
        """Insert values of the new nodes between those of the mesh and of frames."""
        n = self.coarse.n_nodes
        return np.concatenate([values[:n], new, values[n:]])

    def among(self, held: Bool[HostArray, "n_all ..."]) -> Bool[HostArray, "n_new ..."]:
        """Say which new nodes belong to a set, given by a mask of the coarse nodes.

        A new node belongs to it if all nodes that it is interpolated from do.
        """
        aside = (self.weights == 0.0).reshape(*self.weights.shape, *(1,) * held[0].ndim)
        return np.all(held[self.carriers] | aside, axis=1)

    def carried(
        self, values: Float[HostArray, "n_all ..."]
    ) -> Float[HostArray, "n_new ..."]:
        """Interpolate values of the coarse nodes at the new ones."""
        return np.einsum("na,na...->n...", self.weights, values[self.carriers])

    def faces(self, faces: Int[HostArray, "n n_fn"]) -> Int[HostArray, "n_finer 6"]:
        """Return the faces of the finer mesh, those of each one after the other."""
        if faces.shape[1] == 6:
            faces = faces[:, _FACES].reshape(-1, 3)
        mids = self.mids(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1))
        return np.hstack([faces, mids]).astype(faces.dtype)

    def mids(self, edges: Int[HostArray, "*n 2"]) -> Int[HostArray, "*n"]:
        """Return the mid nodes of edges of the finer mesh, by their ends."""
        return MidNodes(self.linear).of(edges)


def finer(mesh: TetMesh) -> Refinement:
    """Refine a mesh once: linear tets become quadratic, quadratic ones eight each."""
    if mesh.order == 1:
        linear, corners = mesh, np.broadcast_to(_LINEAR, (mesh.n_tets, 4, 4))
    else:
        linear, local = _split(mesh)
        corners = _QUADRATIC[local]
    fine = to_quadratic(linear)
    n, n_en = mesh.n_nodes, mesh.tets.shape[1]
    mids = corners[:, np.array(TET_EDGES)].mean(axis=2)
    carriers = np.zeros((fine.n_nodes - n, n_en), mesh.tets.dtype)
    weights = np.zeros(carriers.shape)
    new = fine.tets[:, 4:] - n
    of_parent = np.repeat(mesh.tets, fine.n_tets // mesh.n_tets, axis=0)
    carriers[new] = of_parent[:, None]
    weights[new] = shape_functions(mids, n_en)
    straight = Refinement(mesh, linear, fine, corners, carriers, weights)
    points = np.concatenate([mesh.points, straight.carried(mesh.points)])
    return straight._replace(mesh=replace(fine, points=points))


def _split(mesh: TetMesh) -> tuple[TetMesh, Int[HostArray, "n_finer_tets 4"]]:
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
