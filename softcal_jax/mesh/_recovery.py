"""Recovery of values that jump between tets as a continuous field, by patches."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.elements import TET_EDGES, TET_FACES, shape_functions, tet_rule
from softcal_jax.mesh._tet_mesh import TetMesh
from softcal_jax.mesh._topology import (
    area_normals,
    boundary_face_indices,
    jacobian_determinants,
    tet_faces,
)

_TERMS = {0: 1, 1: 4, 2: 10}  # terms of a polynomial, by its degree

_LEAST = {degree: 2 * terms for degree, terms in _TERMS.items()}
"""Fewest points of a patch, by degree, while there are more tets around it."""

_DEPENDENT = 0.01
"""Singular value of quadratic terms at the points of a patch, relative to the largest,
below which the points do not determine the term [-]."""

_IN_FACE = np.full((3, 3), 1.0 / 6.0) + np.eye(3) / 2.0
"""Points in a triangle that integrate polynomials of degree 2, barycentric [-]."""


class Recovery(NamedTuple):
    """How to recover values at quadrature points as a continuous field.

    Superconvergent patch recovery (Zienkiewicz and Zhu, Int. J. Numer. Methods Eng. 33,
    1992): around each corner node, a polynomial of the order of the tets is fitted to
    the values of the points of the patch, and read at the nodes. Tets of different
    groups are recovered apart, as parts, since fields jump where materials meet.

    Attributes:
        node: Node that each weight belongs to; a node is numbered once per part.
        point: Quadrature point that the weight applies to, counted tet by tet.
        weight: Weight of this point in the value of this node [-].
        tets: Nodes of each tet, numbered like `node`.
        from_nodes: Shape functions at the points of a finer rule [-].
        from_points: Weights that extend the values of a tet linearly to these [-].
        volumes: Volume of each finer point; 0 in tets that do not deform [m3].
        face_tet: Tet behind each boundary face.
        face_nodes: Nodes of the face in the mesh.
        face_normal: Outward normal of the triangle of the face's corners [-].
        face_from_points: Weights that extend values to three points of the face [-].
        face_volume: A third of the volume of the tet behind the face [m3].
    """

    node: Int[HostArray, " n_weights"]
    point: Int[HostArray, " n_weights"]
    weight: Float[HostArray, " n_weights"]
    tets: Int[HostArray, "n_tets n_en"]
    from_nodes: Float[HostArray, "n_fine n_en"]
    from_points: Float[HostArray, "n_fine n_qp"]
    volumes: Float[HostArray, "n_tets n_fine"]
    face_tet: Int[HostArray, " n_faces"]
    face_nodes: Int[HostArray, "n_faces n_fn"]
    face_normal: Float[HostArray, "n_faces 3"]
    face_from_points: Float[HostArray, "n_faces 3 n_qp"]
    face_volume: Float[HostArray, " n_faces"]


def recovery(mesh: TetMesh, deforming: Bool[HostArray, " n_tets"]) -> Recovery:
    """Prepare the recovery of values at the quadrature points of the tets that deform.

    The quadrature points are the centroid of a linear tet, and the four points of
    `tet_rule(2)` of a quadratic one.
    """
    n_en = mesh.tets.shape[1]
    rule, fine = tet_rule(mesh.order), tet_rule(2 * mesh.order)
    N = shape_functions(rule.barycentric, n_en)
    samples = np.einsum("qa,tai->tqi", N, mesh.points[mesh.tets])
    part = np.where(deforming, _parts(mesh), -1)
    keys = np.where(deforming, part, 0)[:, None] * mesh.n_nodes + mesh.tets
    nodes, tets = np.unique(keys, return_inverse=True)
    tets = tets.reshape(mesh.tets.shape)
    points = mesh.points[nodes % mesh.n_nodes]
    weights = list(_weights(tets[deforming], samples[deforming], points, mesh.order))
    of_deforming = np.flatnonzero(deforming)
    node, point, weight = map(np.concatenate, zip(*weights, strict=True))
    tet, q = np.divmod(point, samples.shape[1])
    volumes = jacobian_determinants(mesh, fine.barycentric) * fine.weights / 6.0

    faces = boundary_face_indices(mesh.tets[deforming])
    behind = of_deforming[faces // len(TET_FACES)]
    face_nodes = tet_faces(mesh.tets[deforming])[faces]
    normal = area_normals(mesh.points[face_nodes[:, :3]])
    in_tet = np.zeros((len(TET_FACES), 3, 4))
    for k, corners in enumerate(TET_FACES):
        in_tet[k][:, corners] = _IN_FACE
    return Recovery(
        node=node.astype(np.int32),
        point=(of_deforming[tet] * samples.shape[1] + q).astype(np.int32),
        weight=weight,
        tets=tets,
        from_nodes=shape_functions(fine.barycentric, n_en),
        from_points=_continued(rule.barycentric, fine.barycentric),
        volumes=np.where(deforming[:, None], volumes, 0.0),
        face_tet=behind,
        face_nodes=face_nodes,
        face_normal=normal / np.linalg.norm(normal, axis=1, keepdims=True),
        face_from_points=_continued(rule.barycentric, in_tet)[faces % len(TET_FACES)],
        face_volume=volumes[behind].sum(axis=1) / 3.0,
    )


def _parts(mesh: TetMesh) -> Int[HostArray, " n_tets"]:
    """Number the parts: tets in the same tet groups have the same number."""
    within = np.zeros((mesh.n_tets, 1 + len(mesh.tet_groups)), bool)
    for k, tets in enumerate(mesh.tet_groups.values()):
        within[tets, k] = True
    return np.unique(within, axis=0, return_inverse=True)[1].ravel()


def _continued(points: HostArray, to: HostArray) -> HostArray:
    """Return weights that extend values at one or four points of a tet linearly."""
    if len(points) == 1:
        return np.ones((*to.shape[:-1], 1))
    return to @ np.linalg.inv(points)


def _weights(
    tets: Int[HostArray, "n_tets n_en"],
    samples: Float[HostArray, "n_tets n_qp 3"],
    points: Float[HostArray, "n_nodes 3"],
    order: int,
) -> Iterator[tuple[HostArray, HostArray, HostArray]]:
    """Fit each patch, and yield the weights of its points in the values of its nodes.

    A mid node takes the mean of the polynomials at both ends of its edge.
    """
    n_qp = samples.shape[1]
    of_node, mids = _around(tets)
    for corner, patch in of_node.items():
        nodes = [corner, *sorted(mids.get(corner, ()))]
        rows, degree, least = None, order, _LEAST
        while rows is None:
            x = samples[patch].reshape(-1, 3)
            if len(x) >= least[degree]:
                rows = _fit(x, points[nodes], degree)
            if rows is None:
                around = {node for tet in patch for node in tets[tet, :4].tolist()}
                wider = sorted({tet for node in around for tet in of_node[node]})
                if len(wider) == len(patch):  # there are no more tets
                    degree, least = degree - (least is _TERMS), _TERMS
                patch = wider
        rows[1:] /= 2.0
        index = (n_qp * np.array(patch)[:, None] + np.arange(n_qp)).ravel()
        yield np.repeat(nodes, index.size), np.tile(index, len(nodes)), rows.ravel()


def _around(
    tets: Int[HostArray, "n_tets n_en"],
) -> tuple[dict[int, list[int]], dict[int, set[int]]]:
    """List the tets around each corner node, and the mid nodes of its edges."""
    of_node: dict[int, list[int]] = {}
    for tet, corners in enumerate(tets[:, :4].tolist()):
        for node in corners:
            of_node.setdefault(node, []).append(tet)
    mids: dict[int, set[int]] = {}
    for k in range(4, tets.shape[1]):
        for end in TET_EDGES[k - 4]:
            for node, mid in tets[:, [end, k]].tolist():
                mids.setdefault(node, set()).add(mid)
    return of_node, mids


def _fit(
    x: Float[HostArray, "n 3"], read: Float[HostArray, "m 3"], order: int
) -> Float[HostArray, "m n"] | None:
    """Return the weights of values at `x` in a least-squares polynomial at `read`.

    Coordinates have unit variance, since patches of thin walls are flat. Quadratic
    terms that the points do not determine are left out, as on the corners of a cube,
    which lie on a sphere. None if all points lie in a plane.
    """
    if order == 0:
        return np.full((len(read), len(x)), 1.0 / len(x))
    centre = x.mean(axis=0)
    _, size, axes = np.linalg.svd(x - centre, full_matrices=False)
    if size[-1] < 1e-6 * size[0]:
        return None
    scale = size / np.sqrt(len(x))
    samples, nodes = ((p - centre) @ axes.T / scale for p in (x, read))
    linear = lambda p: np.column_stack([np.ones(len(p)), p])
    fit = np.linalg.pinv(linear(samples))
    weights = linear(nodes) @ fit
    if order == 2:
        square = lambda p: (p[:, :, None] * p[:, None, :])[:, *np.triu_indices(3)]
        rest = square(samples) - linear(samples) @ fit @ square(samples)
        beyond = square(nodes) - linear(nodes) @ fit @ square(samples)
        weights += beyond @ np.linalg.pinv(rest, rcond=_DEPENDENT)
    return weights
