"""Selection of nodes and faces by name, index or position.

A predicate is any callable that takes points (n, 3) [m] and gives n booleans, so
regions combine by a lambda: `lambda x: box(x) & ~sphere(x)`.
"""

from collections.abc import Callable

import numpy as np

from softcal_jax._typing import HostArray, Int
from softcal_jax._units import readable
from softcal_jax.mesh._regions import AbstractRegion, place
from softcal_jax.mesh._tet_mesh import TetMesh
from softcal_jax.mesh._topology import boundary_faces

Predicate = Callable[[HostArray], HostArray]
"""A region like `Box`, or any callable from points [m] to booleans."""


def select_nodes(mesh: TetMesh, where: Predicate) -> Int[HostArray, " n"]:
    """Select the nodes whose position satisfies a predicate, sorted.

    Raises:
        ValueError: If no node satisfies it, or it does not give one boolean per point.
    """
    nodes = np.flatnonzero(_mask(mesh, where))
    if not nodes.size:
        raise ValueError(f"no node lies in {where}. {_whereabouts(mesh, where)}")
    return nodes.astype(np.int32)


def select_faces(mesh: TetMesh, where: Predicate) -> Int[HostArray, "n n_fn"]:
    """Select the boundary faces whose nodes all satisfy a predicate, normals outwards.

    Raises:
        ValueError: If no face satisfies it, or it does not give one boolean per point.
    """
    mask = _mask(mesh, where)
    faces = boundary_faces(mesh)
    faces = faces[mask[faces].all(axis=1)]
    if not faces.size:
        raise ValueError(
            f"no boundary face has all its nodes in {where}; {mask.sum()} nodes lie in "
            f"it. {_whereabouts(mesh, where)}"
        )
    return faces


def node_indices(
    mesh: TetMesh, where: str | Int[HostArray, " n"], owner: str
) -> Int[HostArray, " _"]:
    """Return the nodes of a group, or check given ones; errors name their owner.

    Raises:
        ValueError: If the group is unknown, or the indices are no list of integers
            from 0 to the number of nodes.
    """
    if isinstance(where, str):
        try:
            return mesh.nodes(where)
        except ValueError as error:
            raise ValueError(f"{owner}: {error}") from error
    nodes = np.asarray(where)
    if nodes.ndim != 1 or nodes.dtype.kind not in "iu":
        remedy = " (np.flatnonzero turns a mask into indices)" * (nodes.dtype == bool)
        raise ValueError(
            f"{owner} needs the name of a group or a list of integer node indices"
            f"{remedy}, got {nodes.dtype} of shape {nodes.shape}."
        )
    outside = nodes[(nodes < 0) | (nodes >= mesh.n_nodes)]
    if outside.size:
        raise ValueError(
            f"{owner}: node {outside[0]} is not in the mesh, whose nodes are 0 to "
            f"{mesh.n_nodes - 1}."
        )
    return nodes


def _mask(mesh: TetMesh, where: Predicate) -> HostArray:
    mask = np.asarray(where(mesh.points))
    if mask.dtype != bool or mask.shape != (mesh.n_nodes,):
        raise ValueError(
            f"the predicate must give one boolean for each of {mesh.n_nodes} points, "
            f"got {mask.dtype} of shape {mask.shape}."
        )
    return mask


def _whereabouts(mesh: TetMesh, where: Predicate) -> str:
    lower, upper = mesh.points.min(axis=0), mesh.points.max(axis=0)
    text = f"The mesh spans {place(lower)} to {place(upper)}."
    if isinstance(where, AbstractRegion):
        nearest = readable(float(where.distance(mesh.points).min()), "m")
        text += f" The nearest node is {nearest} away; check the length unit."
    return text
