"""Conversion of meshes between linear and quadratic tets, groups included."""

import numpy as np

from softcal_jax._typing import HostArray
from softcal_jax.elements import TET_EDGES
from softcal_jax.mesh._tet_mesh import TetMesh


def check_order(order: int) -> None:
    """Raise a `ValueError` unless the order is 1 or 2."""
    if order not in (1, 2):
        raise ValueError(f"order must be 1 (linear) or 2 (quadratic), got {order}.")


class MidNodes:
    """Index of the mid node of each edge of the mesh."""

    def __init__(self, mesh: TetMesh):
        self.n_nodes = mesh.n_nodes
        keys = self._keys(mesh.tets[:, np.array(TET_EDGES)])
        self.keys, self.inverse = np.unique(keys, return_inverse=True)
        self.edges = np.stack([self.keys // self.n_nodes, self.keys % self.n_nodes], 1)

    def _keys(self, edges: HostArray) -> HostArray:
        edges = np.sort(edges.astype(np.int64), axis=-1)
        return edges[..., 0] * self.n_nodes + edges[..., 1]

    def of(self, edges: HostArray) -> HostArray:
        """Find the mid nodes of edges that exist in the mesh."""
        return self.n_nodes + np.searchsorted(self.keys, self._keys(edges))

    def between(self, nodes: HostArray) -> HostArray:
        """Find the mid nodes of the edges with both ends among `nodes`."""
        chosen = np.zeros(self.n_nodes, dtype=bool)
        chosen[nodes] = True
        return self.n_nodes + np.flatnonzero(chosen[self.edges].all(axis=1))


def to_quadratic(mesh: TetMesh) -> TetMesh:
    """Convert a linear mesh to straight-sided quadratic tets, with the same groups.

    Corners keep their indices; mid nodes are appended. A node group that is exactly
    the nodes of the surface or tet group of the same name gains the mid nodes of those
    faces or tets. Any other node group gains the mid node of each edge that has both
    ends in it, even if the edge crosses the body between two parts of the group: where
    the mesh is one cell thick, name the faces instead.

    Raises:
        ValueError: If the mesh is quadratic already, or a surface group holds a face
            whose edges are not edges of the mesh.
    """
    if mesh.order == 2:
        raise ValueError("the mesh is quadratic already.")
    mid = MidNodes(mesh)
    tets = np.hstack([mesh.tets, mesh.n_nodes + mid.inverse.reshape(-1, 6)])
    points = np.vstack([mesh.points, mesh.points[mid.edges].mean(axis=1)])

    surfaces = {}
    for name, faces in mesh.surface_groups.items():
        edges = faces[:, [[0, 1], [1, 2], [2, 0]]]
        if not np.isin(mid._keys(edges), mid.keys).all():
            raise ValueError(
                f"surface group {name!r} has a face that is not a face of a tet."
            )
        surfaces[name] = np.hstack([faces, mid.of(edges)])

    def grown(name: str, nodes: HostArray) -> HostArray:
        if name in surfaces and _same(nodes, mesh.surface_groups[name]):
            return np.unique(surfaces[name])
        if name in mesh.tet_groups and _same(nodes, mesh.tets[mesh.tet_groups[name]]):
            return np.unique(tets[mesh.tet_groups[name]])
        return np.concatenate([np.unique(nodes), mid.between(nodes)])

    nodes = {name: grown(name, group) for name, group in mesh.node_groups.items()}
    return TetMesh(points, tets, nodes, surfaces, mesh.tet_groups)


def _same(nodes: HostArray, cells: HostArray) -> bool:
    return np.array_equal(np.unique(nodes), np.unique(cells))


def to_linear(mesh: TetMesh) -> TetMesh:
    """Convert a quadratic mesh to linear tets with straight edges and the same groups.

    Raises:
        ValueError: If the mesh is linear already, or a node group has mid nodes only.
    """
    if mesh.order == 1:
        raise ValueError("the mesh is linear already.")
    corners = np.unique(mesh.tets[:, :4])
    index = np.full(mesh.n_nodes, -1, dtype=np.int32)
    index[corners] = np.arange(len(corners))
    nodes = {
        name: index[np.intersect1d(group, corners)]
        for name, group in mesh.node_groups.items()
    }
    surfaces = {name: index[f[:, :3]] for name, f in mesh.surface_groups.items()}
    tets = index[mesh.tets[:, :4]]
    return TetMesh(mesh.points[corners], tets, nodes, surfaces, mesh.tet_groups)
