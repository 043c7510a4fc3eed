"""Checks that a mesh can be simulated."""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from softcal_jax._typing import HostArray, Int
from softcal_jax.elements import TET_EDGES, tet_rule
from softcal_jax.mesh._tet_mesh import TetMesh
from softcal_jax.mesh._topology import (
    SharedFaces,
    face_table,
    jacobian_determinants,
    tet_faces,
)

FLAT = 1e-6
"""Volume below which a tet is flat, over the regular tet of the same rms edge [-]."""


def check_mesh(mesh: TetMesh, *, linked: Sequence[Int[HostArray, " _"]] = ()) -> None:
    """Check that every tet has a positive volume and that the tets form one body.

    A quadratic tet must have det dX/dxi > 0 at its ten nodes and at the quadrature
    points of degree 4. Tets form one body if they are connected by shared faces; parts
    that share only a node or an edge would form a hinge. Parts with nodes in the same
    `linked` set count as one: something else, such as a rigid body, holds them.

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
    if problems:
        several = "\n- " if len(problems) > 1 else " "
        raise ValueError("bad mesh:" + "".join(several + text for text in problems))


def _listed(mesh: TetMesh, tets: HostArray) -> str:
    """List the first few tets with their centres."""
    centres = mesh.points[mesh.tets[tets[:5]]].mean(axis=1).tolist()
    shown = [
        f"{t} at ({x:.4g}, {y:.4g}, {z:.4g})"
        for t, (x, y, z) in zip(tets[:5], centres, strict=True)
    ]
    return ", ".join(shown) + ", ..." * (len(tets) > 5) + " [m]"


def _unused(mesh: TetMesh) -> Iterator[str]:
    unused = np.setdiff1d(np.arange(mesh.n_nodes), mesh.tets)
    if unused.size:
        yield (
            f"{unused.size} of {mesh.n_nodes} nodes are unused (in no tet): "
            f"{unused[:5].tolist()}{', ...' * (unused.size > 5)}. Remove them."
        )


def _bad_shapes(mesh: TetMesh) -> Iterator[str]:
    X = mesh.points[mesh.tets[:, :4]]
    vectors = np.diff(X[:, np.array(TET_EDGES)], axis=2)[:, :, 0]
    rms = np.sqrt((vectors**2).sum(axis=-1).mean(axis=-1))
    volume = np.linalg.det(X[:, 1:] - X[:, :1]) / 6.0
    # Over that of the regular tet with the same rms edge. Tets whose nodes all coincide
    # have neither volume nor edges.
    shape = 6.0 * np.sqrt(2.0) * volume / np.maximum(rms, np.finfo(float).tiny) ** 3
    flat = np.abs(shape) < FLAT
    inverted = (shape < 0) & ~flat
    folded = np.zeros_like(flat)
    if mesh.order == 2:
        corners = np.eye(4)
        mids = corners[np.array(TET_EDGES)].mean(axis=1)
        samples = np.vstack([corners, mids, tet_rule(4).barycentric])
        folded = (jacobian_determinants(mesh, samples) <= 0).any(axis=1)
    for bad, what, remedy in (
        (flat, "tets are degenerate (flat)", "Remesh them"),
        (
            inverted,
            "tets are inverted (negative volume)",
            "Swap two corners of each (and their mid nodes; for linear tets it is "
            "softcal_jax.mesh.oriented(tets, points[tets])), or remesh",
        ),
        (
            folded & ~flat & ~inverted,
            "curved tets are inverted (folded by their mid nodes)",
            "Move the mid nodes towards the middle of their edges",
        ),
    ):
        if bad.any():
            listed = _listed(mesh, np.flatnonzero(bad))
            yield f"{bad.sum()} of {mesh.n_tets} {what}: {listed}. {remedy}."


def _repeated(mesh: TetMesh, table: SharedFaces) -> Iterator[str]:
    corners = np.sort(mesh.tets[:, :4], axis=1)
    _, first = np.unique(corners, axis=0, return_index=True)
    again = np.setdiff1d(np.arange(mesh.n_tets), first)
    # Of two tets on either side of a face, one has its nodes in an odd order.
    X = mesh.points[mesh.tets[:, :4]]
    inverted = np.linalg.det(X[:, 1:] - X[:, :1]) < 0
    a, b, c = tet_faces(mesh.tets)[:, :3].T
    odd = (a > b) ^ (b > c) ^ (a > c) ^ np.repeat(inverted, 4)
    one_side = (table.counts == 2) & (np.bincount(table.inverse, odd) != 1)
    bad = (table.counts > 2) | one_side
    crowded = np.unique(np.flatnonzero(bad[table.inverse]) // 4)
    if again.size:
        listed = _listed(mesh, again)
        yield f"{again.size} tets repeat another one: {listed}. Remove the copies."
    elif crowded.size:
        yield (
            f"{crowded.size} tets overlap (a face belongs to more than two, or to two "
            f"on the same side of it): {_listed(mesh, crowded)}. Remesh them."
        )


def _disconnected(mesh: TetMesh, table: SharedFaces, linked) -> Iterator[str]:
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
        return
    sizes = sorted(np.bincount(part).tolist(), reverse=True)
    listed = ", ".join(map(str, sizes[:5])) + ", ..." * (n_parts > 5)
    pairs = KDTree(mesh.points).query_pairs(1e-9 * mesh.size)
    remedy = f"{len(pairs)} pairs of nodes coincide: merge them."
    if not pairs:
        remedy = (
            "Join them, keep one, or link them by a rigid body and read the file with "
            'parts = "linked".'
        )
    yield (
        f"it is disconnected: {n_parts} parts of {listed} tets that share no face. "
        + remedy
    )
