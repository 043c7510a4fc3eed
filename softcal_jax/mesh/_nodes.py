"""Nodes given by a group or by indices."""

import numpy as np

from softcal_jax._typing import HostArray, Int
from softcal_jax.mesh._tet_mesh import TetMesh


def named_nodes(
    mesh: TetMesh, where: str | Int[HostArray, " n"], owner: str
) -> Int[HostArray, " _"]:
    """Find nodes as `node_indices` does; errors also name the owner of a group.

    Args:
        mesh: The mesh.
        where: Name of a group, or node indices.
        owner: Kind and name of what acts on the nodes, for messages.

    Raises:
        ValueError: As `node_indices`.
    """
    if not isinstance(where, str):
        return node_indices(mesh, where, owner)
    try:
        return mesh.nodes(where)
    except ValueError as error:
        raise ValueError(f"{owner}: {error}") from error


def node_indices(
    mesh: TetMesh, where: str | Int[HostArray, " n"], owner: str
) -> Int[HostArray, " _"]:
    """Return the indices of the nodes of a group, or check given ones.

    Args:
        mesh: The mesh.
        where: Name of a group, or node indices.
        owner: What acts on the nodes, for messages.

    Raises:
        ValueError: If the group is unknown, or the indices are no list of integers
            from 0 to the number of nodes.
    """
    if isinstance(where, str):
        return mesh.nodes(where)
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
