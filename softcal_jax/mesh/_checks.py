"""Checks that a mesh can be simulated."""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from softcal_jax._typing import HostArray, Int
from softcal_jax.elements import TET_EDGES, tet_rule
from softcal_jax.mesh._tet_mesh import TetMesh
from softcal_jax.mesh._topology import FaceTable, face_table, jacobian_determinants

FLAT = 1e-6
"""Volume below which a tet is flat, over the regular tet of the same rms edge [-]."""


def check_mesh(mesh: TetMesh, *, linked: Sequence[Int[HostArray, " _"]] = ()) -> None:
    """Check that every tet has a positive volume and that the tets form one body.

    A quadratic tet must have det dX/dxi > 0 at its ten nodes and at the quadrature
    points of degree 4. Tets form one body if they are connected by shared faces; parts
    that share only a node or an edge would form a hinge.

    Args:
        mesh: The mesh.
        linked: Sets of nodes that are held together by something else, such as a rigid
            body: parts with nodes in the same set count as one.

    Raises:
        ValueError: If tets are inverted, flat, repeated or overlapping, nodes are
            unused, or the body is disconnected; the message lists all problems.
    """
    table = face_table(mesh.tets)
    problems = [
        *_unused(mesh),
        *_bad_shapes(mesh),
        *_repeated(mesh, table),
        *_disconnected(mesh, table, linked),
    ]
    if len(problems) == 1:
        raise ValueError(f"bad mesh: {problems[0]}")
    if problems:
        raise ValueError("bad mesh:\n- " + "\n- ".join(problems))


def shape_volumes(mesh: TetMesh) -> HostArray:
    """Divide signed volumes by that of the regular tet with the same rms edge [-]."""
    corners = mesh.points[mesh.tets[:, :4]]
    edges = np.array(TET_EDGES)
    vectors = corners[:, edges[:, 1]] - corners[:, edges[:, 0]]
    rms = np.sqrt((vectors**2).sum(axis=-1).mean(axis=-1))
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
    # Tets whose nodes all coincide have neither volume nor edges.
    return 6.0 * np.sqrt(2.0) * volume / np.maximum(rms, np.finfo(float).tiny) ** 3


def _listed(mesh: TetMesh, tets: HostArray) -> str:
    """List the first few tets with their centres."""
    centres = mesh.points[mesh.tets[tets[:5]]].mean(axis=1).tolist()
    shown = [
        f"{t} at ({x:.4g}, {y:.4g}, {z:.4g})"
        for t, (x, y, z) in zip(tets[:5], centres, strict=True)
    ]
    return ", ".join(shown) + ", ..." * (len(tets) > 5) + " [m]"


def _unused(mesh: TetMesh) -> list[str]:
    unused = np.setdiff1d(np.arange(mesh.n_nodes), mesh.tets)
    if not unused.size:
        return []
    return [
        f"{unused.size} of {mesh.n_nodes} nodes are unused (in no tet): "
        f"{unused[:5].tolist()}{', ...' * (unused.size > 5)}. Remove them."
    ]


def _bad_shapes(mesh: TetMesh) -> list[str]:
    shape = shape_volumes(mesh)
    flat = np.abs(shape) < FLAT
    inverted = (shape < 0) & ~flat
    problems = []
    if flat.any():
        problems.append(
            f"{flat.sum()} of {mesh.n_tets} tets are degenerate (flat): "
            f"{_listed(mesh, np.flatnonzero(flat))}. Remesh them."
        )
    if inverted.any():
        problems.append(
            f"{inverted.sum()} of {mesh.n_tets} tets are inverted (negative volume): "
            f"{_listed(mesh, np.flatnonzero(inverted))}. Swap two corners of each (and "
            "their mid nodes), or remesh where the body folds."
        )
    if mesh.order == 2:
        det = jacobian_determinants(mesh, _sample_points())
        folded = (det <= 0).any(axis=1) & ~flat & ~inverted
        if folded.any():
            problems.append(
                f"{folded.sum()} of {mesh.n_tets} curved tets are inverted (folded by "
                f"their mid nodes): {_listed(mesh, np.flatnonzero(folded))}. Move the "
                "mid nodes towards the middle of their edges."
            )
    return problems


def _sample_points() -> HostArray:
    corners = np.eye(4)
    mids = corners[np.array(TET_EDGES)].mean(axis=1)
    return np.vstack([corners, mids, tet_rule(4).barycentric])


def _repeated(mesh: TetMesh, table: FaceTable) -> list[str]:
    corners = np.sort(mesh.tets[:, :4], axis=1)
    _, first = np.unique(corners, axis=0, return_index=True)
    again = np.setdiff1d(np.arange(mesh.n_tets), first)
    if again.size:
        return [
            f"{again.size} tets repeat another one: {_listed(mesh, again)}. "
            "Remove the copies."
        ]
    crowded = np.unique(np.flatnonzero(table.counts[table.inverse] > 2) // 4)
    if crowded.size:
        return [
            f"{crowded.size} tets overlap (a face belongs to more than two): "
            f"{_listed(mesh, crowded)}. Remesh them."
        ]
    return []


def _disconnected(mesh: TetMesh, table: FaceTable, linked) -> list[str]:
    tet = np.repeat(np.arange(mesh.n_tets), 4)
    shape = (mesh.n_tets, len(table.counts))
    on_face = coo_array((np.ones(len(tet)), (tet, table.inverse)), shape).tocsr()
    _, part = connected_components(on_face @ on_face.T, directed=False)
    for nodes in linked:
        held = np.isin(part, part[np.isin(mesh.tets, nodes).any(axis=1)])
        part = np.where(held, part[held].min(), part)
    part = np.unique(part, return_inverse=True)[1]
    n_parts = int(part.max()) + 1
    if n_parts == 1:
        return []
    sizes = sorted(np.bincount(part).tolist(), reverse=True)
    listed = ", ".join(map(str, sizes[:5])) + ", ..." * (n_parts > 5)
    pairs = KDTree(mesh.points).query_pairs(1e-9 * mesh.size, output_type="ndarray")
    remedy = (
        f"{len(pairs)} pairs of nodes coincide: merge them"
        if len(pairs)
        else "Join them, keep one, or link them by a rigid body"
    )
    return [
        f"it is disconnected: {n_parts} parts of {listed} tets that share no face. "
        f"{remedy}."
    ]
