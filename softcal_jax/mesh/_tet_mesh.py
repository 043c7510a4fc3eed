"""The tetrahedral mesh, its named groups, and its conversion between orders."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import equinox as eqx
import numpy as np

from softcal_jax._module import Module
from softcal_jax._text import unknown_name
from softcal_jax._typing import Array, Float, HostArray, Int, check_untraced
from softcal_jax.elements import TET_EDGES

ArrayData = HostArray | Sequence
"""An array or nested lists of numbers, as a user types them."""

FACE_NODES_OF_TET = {4: 3, 10: 6}  # nodes of a face, by the nodes of its tet

_FAR = 1e12
"""Bound on coordinates, which keeps the cubes of lengths far from overflow [m]."""


def _as_points(points: ArrayData) -> HostArray:
    check_untraced("an array of points", points, "them", "with_points")
    return np.asarray(points, dtype=np.float64)


def _as_indices(indices: ArrayData) -> HostArray:
    array = np.asarray(indices)
    if array.dtype.kind not in "iu":
        remedy = " (np.flatnonzero turns a mask into indices)" * (array.dtype == bool)
        raise ValueError(
            f"nodes and tets are given by integer indices{remedy}, got {array.dtype}."
        )
    return array.astype(np.int32)


def _as_groups(groups: Mapping[str, ArrayData]) -> dict[str, HostArray]:
    return {str(name): _as_indices(members) for name, members in groups.items()}


def _unknown_group(kind: str, name: str, known: Mapping[str, object]) -> ValueError:
    """Build the error for an unknown group; without any group, say how to make one."""
    if known:
        return unknown_name(kind, name, known)
    return ValueError(
        f"unknown {kind} {name!r}: the mesh has none. Name the parts where the mesh is "
        "made (physical groups in Gmsh), or take them by place: [groups.NAME] in a "
        "project file, `select_nodes` and `select_faces` in Python."
    )


class TetMesh(Module):
    """Nodes, tets and the named groups that supports, loads and laws refer to.

    Node order inside a tet is VTK's (see `softcal_jax.elements`). Shapes and index
    ranges are checked here; geometry is checked by `check_mesh`.

    Attributes:
        points: Node positions [m].
        tets: Node indices of each tet: 4 (linear) or 10 (quadratic).
        node_groups: Node indices by name.
        surface_groups: Faces by name, 3 or 6 nodes each; a face of the boundary has
            its normal pointing outwards.
        tet_groups: Tet indices by name.
    """

    points: Float[HostArray, "n_nodes 3"] = eqx.field(converter=_as_points)
    tets: Int[HostArray, "n_tets n_en"] = eqx.field(converter=_as_indices)
    node_groups: dict[str, Int[HostArray, " _"]] = eqx.field(
        converter=_as_groups, default_factory=dict
    )
    surface_groups: dict[str, Int[HostArray, "_ n_fn"]] = eqx.field(
        converter=_as_groups, default_factory=dict
    )
    tet_groups: dict[str, Int[HostArray, " _"]] = eqx.field(
        converter=_as_groups, default_factory=dict
    )

    def __check_init__(self):
        if self.points.ndim != 2 or self.points.shape[1] != 3:
            raise ValueError(
                f"points must have the shape (n_nodes, 3), got {self.points.shape}."
            )
        bad = np.flatnonzero(~(np.abs(self.points) < _FAR).all(axis=1))
        if bad.size:
            where = self.points[bad[0]].tolist()
            raise ValueError(f"node {bad[0]} has the position {where} [m].")
        if self.tets.ndim != 2 or self.tets.shape[1] not in FACE_NODES_OF_TET:
            raise ValueError(
                "tets must have the shape (n_tets, 4) or (n_tets, 10), "
                f"got {self.tets.shape}."
            )
        self._check_group("tets", self.tets, self.n_nodes)
        for name, nodes in self.node_groups.items():
            self._check_group(f"node group {name!r}", nodes, self.n_nodes)
        for name, faces in self.surface_groups.items():
            width = FACE_NODES_OF_TET[self.tets.shape[1]]
            if faces.ndim != 2 or faces.shape[1] != width:
                raise ValueError(
                    f"surface group {name!r} must have the shape (n_faces, {width}) on "
                    f"tets of {self.tets.shape[1]} nodes, got {faces.shape}."
                )
            self._check_group(f"surface group {name!r}", faces, self.n_nodes)
        for name, tets in self.tet_groups.items():
            self._check_group(f"tet group {name!r}", tets, self.n_tets)

    @staticmethod
    def _check_group(what: str, indices: HostArray, n: int):
        if not indices.size:
            raise ValueError(f"{what} is empty.")
        if indices.min() < 0 or indices.max() >= n:
            worst = indices.min() if indices.min() < 0 else indices.max()
            raise ValueError(f"{what}: index {worst} is outside 0 to {n - 1}.")

    @property
    def words(self) -> str:
        """The numbers of nodes and tets, like "3 218 nodes, 1 540 quadratic tets"."""
        kind = "quadratic" if self.order == 2 else "linear"
        nodes, tets = (f"{n:,}".replace(",", " ") for n in (self.n_nodes, self.n_tets))
        return f"{nodes} nodes, {tets} {kind} tets"

    def _words(self) -> str:
        groups = {*self.node_groups, *self.surface_groups, *self.tet_groups}
        named = f", groups {', '.join(sorted(groups))}" if groups else ""
        return self.words + named

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return self.points.shape[0]

    @property
    def n_tets(self) -> int:
        """Number of tets."""
        return self.tets.shape[0]

    @property
    def centroids(self) -> Float[HostArray, "n_tets 3"]:
        """Means of the corners of each tet [m]."""
        return self.points[self.tets[:, :4]].mean(axis=1)

    @property
    def order(self) -> int:
        """Polynomial order of the tets, 1 or 2."""
        return 1 if self.tets.shape[1] == 4 else 2

    @property
    def size(self) -> float:
        """Diagonal of the bounding box [m]."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    def nodes(self, name: str) -> Int[HostArray, " _"]:
        """Return the nodes of a node group, else of a surface or tet group, sorted.

        Raises:
            ValueError: If no group has the name.
        """
        for groups in (self.node_groups, self.surface_groups):
            if name in groups:
                return np.unique(groups[name])
        if name in self.tet_groups:
            return np.unique(self.tets[self.tet_groups[name]])
        known = {**self.node_groups, **self.surface_groups, **self.tet_groups}
        raise _unknown_group("group", name, known)

    def faces(self, name: str) -> Int[HostArray, "_ n_fn"]:
        """Return the faces of a surface group.

        Raises:
            ValueError: If no surface group has the name.
        """
        if name in self.surface_groups:
            return self.surface_groups[name]
        if name in self.node_groups or name in self.tet_groups:
            kind = "nodes" if name in self.node_groups else "tets"
            raise ValueError(
                f"{name!r} is a group of {kind}, and a surface is asked for: of = "
                '"faces" under [groups.NAME] in a project file, `select_faces` in '
                "Python."
            )
        raise _unknown_group("surface group", name, self.surface_groups)

    def tets_of(self, name: str) -> Int[Array | HostArray, " _"]:
        """Return the tet indices of a tet group.

        Raises:
            ValueError: If no tet group has the name.
        """
        if name not in self.tet_groups:
            raise _unknown_group("tet group", name, self.tet_groups)
        return self.tet_groups[name]

    def with_node_group(self, name: str, nodes: ArrayData) -> "TetMesh":
        """Add a node group, given by node indices; repeats are merged.

        Raises:
            ValueError: If the name is taken, or the group is empty or has a member that
                is not in the mesh; surface and tet groups raise it, too.
        """
        return self._with_group("node", name, np.unique(_as_indices(nodes)))

    def with_surface_group(self, name: str, faces: ArrayData) -> "TetMesh":
        """Add a surface group, given by faces like those of `select_faces`."""
        return self._with_group("surface", name, _as_indices(faces))

    def with_tet_group(self, name: str, tets: ArrayData) -> "TetMesh":
        """Add a tet group, given by tet indices; repeats are merged."""
        return self._with_group("tet", name, np.unique(_as_indices(tets)))

    def _with_group(self, kind: str, name: str, members: HostArray) -> "TetMesh":
        groups = getattr(self, f"{kind}_groups")
        if name in groups:
            raise ValueError(
                f"the mesh has a {kind} group {name!r} already; use a new name."
            )
        return replace(self, **{f"{kind}_groups": {**groups, name: members}})


def check_order(order: int) -> None:
    """Raise a `ValueError` unless the order is 1 or 2."""
    if order not in (1, 2):
        raise ValueError(f"order must be 1 (linear) or 2 (quadratic), got {order}.")


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
    n = mesh.n_nodes

    def numbered(pairs: HostArray) -> HostArray:
        low, high = np.sort(pairs.astype(np.int64), axis=-1).T
        return (low * n + high).T

    of_tets = numbered(mesh.tets[:, np.array(TET_EDGES)])
    known, mids = np.unique(of_tets, return_inverse=True)
    edges = np.stack(np.divmod(known, n), axis=1)
    tets = np.hstack([mesh.tets, n + mids.reshape(-1, 6)])
    points = np.vstack([mesh.points, mesh.points[edges].mean(axis=1)])

    surfaces = {}
    for name, faces in mesh.surface_groups.items():
        sides = numbered(faces[:, [[0, 1], [1, 2], [2, 0]]])
        if not np.isin(sides, known).all():
            raise ValueError(
                f"surface group {name!r} has a face that is not a face of a tet."
            )
        surfaces[name] = np.hstack([faces, n + np.searchsorted(known, sides)])

    same = lambda nodes, cells: np.array_equal(np.unique(nodes), np.unique(cells))

    def grown(name: str, nodes: HostArray) -> HostArray:
        if name in surfaces and same(nodes, mesh.surface_groups[name]):
            return np.unique(surfaces[name])
        if name in mesh.tet_groups and same(nodes, mesh.tets[mesh.tet_groups[name]]):
            return np.unique(tets[mesh.tet_groups[name]])
        within = np.isin(edges, nodes).all(axis=1)
        return np.concatenate([np.unique(nodes), n + np.flatnonzero(within)])

    nodes = {name: grown(name, group) for name, group in mesh.node_groups.items()}
    return TetMesh(points, tets, nodes, surfaces, mesh.tet_groups)


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
