"""Faces, edges, areas and volumes of the tets, and whether they can be simulated.

The boundary is cut into flat triangles. VTK's surface filter cuts the same ones, with
points in single precision, but does not return the weights by which they follow nodes.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.elements import (
    TET_EDGES,
    TET_FACES,
    shape_functions,
    shape_gradients,
    tet_rule,
    triangle_rule,
)
from softcal_jax.mesh._tet_mesh import TetMesh

_MID = {frozenset(edge): 4 + k for k, edge in enumerate(TET_EDGES)}
_FACES = [
    [*face, *(_MID[frozenset((face[i], face[j]))] for i, j in ((0, 1), (1, 2), (2, 0)))]
    for face in TET_FACES
]

LOCAL_FACES = {4: np.array(TET_FACES), 10: np.array(_FACES)}
"""Local nodes of the faces of a tet: corners with their normal outwards, then the mid
nodes of the edges 0-1, 1-2 and 2-0 between them; by nodes per tet."""


def tet_faces(tets: Int[HostArray, "n_tets n_en"]) -> Int[HostArray, "n_faces n_fn"]:
    """List the four faces of every tet, tet by tet, normals outwards."""
    faces = tets[:, LOCAL_FACES[tets.shape[1]]]
    return faces.reshape(-1, faces.shape[-1])


class SharedFaces(NamedTuple):
    """Which faces of the tets coincide."""

    inverse: Int[HostArray, " n_faces"]
    counts: Int[HostArray, " n_unique"]
    """Tets that share each unique face: 1 on the boundary, 2 inside."""


def face_table(tets: Int[HostArray, "n_tets n_en"]) -> SharedFaces:
    """Number the faces of `tet_faces`; a face that two tets share has one number."""
    corners = np.ascontiguousarray(tets[:, :4], np.int64)
    return _face_table(corners.tobytes())


@lru_cache(maxsize=4)
def _face_table(content: bytes) -> SharedFaces:
    """Sort the faces of a mesh once: every marker and group asks for them again."""
    tets = np.frombuffer(content, np.int64).reshape(-1, 4)
    corners = np.sort(tet_faces(tets), axis=1)
    _, inverse, counts = np.unique(
        corners, axis=0, return_inverse=True, return_counts=True
    )
    table = SharedFaces(inverse.ravel(), counts)
    for array in table:
        array.flags.writeable = False  # all callers share it
    return table


def boundary_face_indices(tets: Int[HostArray, "n_tets n_en"]) -> HostArray:
    """Find the indices in `tet_faces` of the faces that belong to one tet only."""
    table = face_table(tets)
    return np.flatnonzero(table.counts[table.inverse] == 1)


def boundary_faces(mesh: TetMesh) -> Int[HostArray, "n_faces n_fn"]:
    """List the faces that belong to one tet only, normals outwards.

    Each has 3 or 6 nodes: corners, then mid nodes.
    """
    return tet_faces(mesh.tets)[boundary_face_indices(mesh.tets)]


def boundary_tets(mesh: TetMesh) -> Int[HostArray, " n_faces"]:
    """Find the index of the tet that has each face of `boundary_faces`."""
    return boundary_face_indices(mesh.tets) // len(TET_FACES)


def face_indices(
    faces: Int[HostArray, "n n_fn"], among: Int[HostArray, "m n_fn"]
) -> Int[HostArray, " n"]:
    """Find each face among others with the same corners, in any order of nodes.

    The index is -1 if no face matches, and that of the first if several do.
    """
    corners = np.sort(np.concatenate([among, faces])[:, :3], axis=1)
    _, first, inverse = np.unique(
        corners, axis=0, return_index=True, return_inverse=True
    )
    indices = first[inverse.ravel()[len(among) :]]
    return np.where(indices < len(among), indices, -1)


class Sides(NamedTuple):
    """The sides of triangles, three of each in a row: 0-1, 1-2, 2-0."""

    edge: Int[HostArray, " n"]  # number of the edge that each is
    forwards: Bool[HostArray, " n"]  # whether it runs from the lower to the higher node
    counts: Int[HostArray, " n_edges"]  # number of sides of each edge

    @property
    def pairs(self) -> Int[HostArray, "n_pairs 2"]:
        """Sides at edges that exactly two share."""
        order = np.argsort(self.edge, kind="stable")
        return order[self.counts[self.edge[order]] == 2].reshape(-1, 2)


def sides_of(triangles: Int[HostArray, "n 3"]) -> Sides:
    """Find which sides of triangles share an edge."""
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
    _, edge, counts = np.unique(
        np.sort(ends, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return Sides(edge.ravel(), ends[:, 0] < ends[:, 1], counts)


def area_normals(corners: Float[HostArray, "n 3 3"]) -> Float[HostArray, "n 3"]:
    """Compute the normals of triangles, with twice their area as length [m2]."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return np.cross(b - a, c - a)


def corner_volumes(corners: HostArray) -> Float[HostArray, " n"]:
    """Compute the volume of tets with straight edges [m3], negative if inverted."""
    return np.linalg.det((corners[:, 1:] - corners[:, :1]).astype(float)) / 6.0


def jacobian_determinants(
    mesh: TetMesh, barycentric: Float[HostArray, "n_points 4"]
) -> Float[HostArray, "n_tets n_points"]:
    """Compute det dX/dxi of every tet at points of the reference tet [m^3]."""
    gradients = shape_gradients(barycentric, mesh.tets.shape[1])
    X = mesh.points[mesh.tets]
    return np.linalg.det(np.einsum("tai,qaj->tqij", X, gradients, optimize=True))


def volumes(mesh: TetMesh) -> Float[HostArray, " n_tets"]:
    """Compute the volume of each tet [m^3], negative if it is inverted.

    The volume is exact: det dX/dxi of a curved tet has degree 3, and so has the rule.
    """
    rule = tet_rule(1 if mesh.order == 1 else 3)
    return jacobian_determinants(mesh, rule.barycentric) @ rule.weights / 6.0


def face_areas(
    mesh: TetMesh, faces: Int[Array | HostArray, "n_faces n_fn"]
) -> tuple[Any, Float[HostArray, "n_qp n_fn"]]:
    """Return areas of quadrature points of faces at rest [m2], and shape functions.

    Differentiable where the points are an array of JAX.
    """
    rule, n_fn = triangle_rule(4), faces.shape[1]
    xp: Any = np if isinstance(mesh.points, np.ndarray) else jnp
    dN = shape_gradients(rule.barycentric, n_fn)
    tangents = xp.einsum("fai,qaj->fqji", mesh.points[faces], dN)
    area = 0.5 * xp.linalg.norm(xp.cross(tangents[:, :, 0], tangents[:, :, 1]), axis=-1)
    return area * rule.weights[None], shape_functions(rule.barycentric, n_fn)


def face_shares(mesh: TetMesh, faces: Int[Array | HostArray, "n_faces n_fn"]) -> Any:
    """Integrate the shape functions of each face at rest [m2]; they sum to its area."""
    area, N = face_areas(mesh, faces)
    return area @ N


def face_products(
    mesh: TetMesh, faces: Int[HostArray, "n_faces n_fn"]
) -> Float[HostArray, "n_faces n_fn n_fn"]:
    """Integrate N_a N_b over each face at rest [m2]; rows sum to `face_shares`."""
    area, N = face_areas(mesh, faces)
    return np.einsum("fq,qa,qb->fab", area, N, N)


def surface_shares(
    mesh: TetMesh, faces: Int[HostArray, "n_faces n_fn"]
) -> Float[HostArray, " n_nodes"]:
    """Integrate every shape function over faces at rest [m2]; the sum is their area."""
    out = np.zeros(mesh.n_nodes)
    np.add.at(out, faces, face_shares(mesh, faces))
    return out


def thin_share(mesh: TetMesh) -> float:
    """Compute the share of the surface whose wall is one or two tets thick [-].

    Its nodes reach the other side of the wall, which faces away from them, over two
    edges of tets.
    """
    faces = boundary_faces(mesh)[:, :3]
    cross = area_normals(mesh.points[faces])
    normal, area = np.zeros((mesh.n_nodes, 3)), np.zeros(mesh.n_nodes)
    np.add.at(normal, faces, cross[:, None])
    np.add.at(area, faces, np.linalg.norm(cross, axis=1)[:, None])
    outer = np.flatnonzero(area)
    normal = normal[outer] / np.linalg.norm(normal[outer], axis=1, keepdims=True)
    ends = mesh.tets[:, np.array(TET_EDGES)].reshape(-1, 2)
    ones, shape = np.ones(len(ends), bool), (mesh.n_nodes, mesh.n_nodes)
    edges = csr_array((ones, (ends[:, 0], ends[:, 1])), shape)
    edges = (edges + edges.T)[outer]
    near, across = (edges @ edges.T + edges[:, outer]).nonzero()
    way = mesh.points[outer[across]] - mesh.points[outer[near]]
    inwards = -np.sum(way * normal[near], axis=1) > 0.5 * np.linalg.norm(way, axis=1)
    away = np.sum(normal[near] * normal[across], axis=1) < -0.5
    thin = np.unique(near[inwards & away])
    return float(area[outer[thin]].sum() / area.sum())


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
        *_disconnected(mesh, linked),
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
    # Over that of the regular tet with the same rms edge. Tets whose nodes all coincide
    # have neither volume nor edges.
    tiny = np.finfo(float).tiny
    shape = 6.0 * np.sqrt(2.0) * corner_volumes(X) / np.maximum(rms, tiny) ** 3
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
    inverted = corner_volumes(mesh.points[mesh.tets[:, :4]]) < 0
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


def connected_parts(tets: Int[HostArray, "n_tets n_en"]) -> Int[HostArray, " n_tets"]:
    """Number the parts of a mesh: tets of one part are connected by shared faces."""
    table, tet = face_table(tets), np.repeat(np.arange(len(tets)), 4)
    shape = (len(tets), len(table.counts))
    on_face = coo_array((np.ones(len(tet)), (tet, table.inverse)), shape).tocsr()
    return connected_components(on_face @ on_face.T, directed=False)[1]


def _disconnected(mesh: TetMesh, linked) -> Iterator[str]:
    part = connected_parts(mesh.tets)
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
