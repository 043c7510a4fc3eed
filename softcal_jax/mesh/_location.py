"""Which tet carries a point, with which weights, and what is nearest to it.

VTK's locators do the same, but their inverse map of a quadratic tet stops at an error
of 3e-7 m on a mesh of 0.1 m, where this one ends in rounding, and they take a curved
face for flat triangles, which misses the nearest point by up to 1e-4 m.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax._units import readable_values
from softcal_jax.elements import TET_EDGES, shape_functions, shape_gradients
from softcal_jax.mesh._tet_mesh import ArrayData, TetMesh
from softcal_jax.mesh._topology import LOCAL_FACES, boundary_face_indices, tet_faces

# A point of a face shared by two tets may be outside both by rounding.
INSIDE = 1e-9


class MaterialPoints(Module):
    """Points that move with the mesh, such as markers.

    The value of a nodal field at point i is sum_a weights[i, a] * field[nodes[i, a]].

    Attributes:
        tet: Tet that carries each point.
        barycentric: Coordinates in this tet; some outside [0, 1] outside the mesh.
        distance: Distance from the mesh [m], 0 inside.
        foot: Nearest point of the mesh, the point itself where that is inside [m].
        nodes: Nodes of the tet.
        weights: Weights of these nodes [-]; rows sum to one.
        slopes: Change of the weights where the point lies elsewhere [1/m].
    """

    tet: Int[HostArray, " n"]
    barycentric: Float[HostArray, "n 4"]
    distance: Float[HostArray, " n"]
    foot: Float[HostArray, "n 3"]
    nodes: Int[HostArray, "n n_en"]
    weights: Float[HostArray, "n n_en"]
    slopes: Float[HostArray, "n n_en 3"]

    def interpolate(
        self, field: Float[Array | HostArray, "n_nodes ..."]
    ) -> Float[Array | HostArray, "n ..."]:
        """Interpolate a nodal field of any shape at the points, in its own unit."""
        weights = self.weights.reshape(self.weights.shape + (1,) * (field.ndim - 1))
        return (weights * field[self.nodes]).sum(axis=1)


def locate(
    mesh: TetMesh,
    points: ArrayData,
    *,
    max_distance: float,
    names: Sequence[str] | None = None,
) -> MaterialPoints:
    """Find the tet that carries each point, and the weights of its nodes.

    Inside the mesh the weights are the shape functions. A point outside, such as a
    marker on a post, is extrapolated linearly from the nearest point xi0 of the
    boundary, N(xi0) + dN/dxi(xi0) (xi - xi0), since the shape functions themselves
    would grow quadratically with the distance. Linear fields are exact in both cases.
    Points [m] may lie `max_distance` outside [m]; messages call them by `names`.

    Raises:
        ValueError: If a point is not finite or lies too far outside, or
            `max_distance` is negative.
    """
    p = np.asarray(points, dtype=float)
    if p.ndim != 2 or p.shape[1] != 3:
        raise ValueError(f"points must have the shape (n, 3), got {p.shape}.")
    bad = np.flatnonzero(~np.isfinite(p).all(axis=1))
    if bad.size:
        raise ValueError(f"point {bad[0]} has the position {p[bad[0]].tolist()} [m].")
    if not max_distance >= 0:
        raise ValueError(f"max_distance must be at least 0 m, got {max_distance}.")

    tet, b = tets_at(mesh, p)
    n_en = mesh.tets.shape[1]
    weights, dN = shape_functions(b, n_en), shape_gradients(b, n_en)
    distance, foot = np.zeros(len(p)), p.copy()
    outside = np.flatnonzero(tet < 0)
    nearest = _nearest_on_boundary(mesh, p[outside])
    for i, (carrier, b0, gap) in zip(outside, nearest, strict=True):
        tet[i], distance[i] = carrier, gap
        X = mesh.points[mesh.tets[tet[i]]]
        N, dN[i] = shape_functions(b0, n_en), shape_gradients(b0, n_en)
        foot[i] = N @ X
        step = np.linalg.solve(X.T @ dN[i], p[i] - foot[i])
        b[i] = b0 + np.concatenate([[-step.sum()], step])
        weights[i] = N + dN[i] @ step
    if (distance > max_distance).any():
        labels = names or [f"point {i}" for i in range(len(p))]
        raise _too_far(mesh, p, distance, max_distance, labels)
    nodes = mesh.tets[tet]
    slopes = dN @ np.linalg.inv(np.swapaxes(mesh.points[nodes], 1, 2) @ dN)
    return MaterialPoints(tet, b, distance, foot, nodes, weights, slopes)


def tets_at(mesh: TetMesh, points: HostArray) -> tuple[HostArray, HostArray]:
    """Find the tet and the coordinates of each point; tet -1 for a point outside."""
    X = mesh.points[mesh.tets]
    lower, upper = bounds(X)
    slack = INSIDE * mesh.size
    tet = np.full(len(points), -1, dtype=np.int32)
    barycentric = np.full((len(points), 4), 0.25)
    for i, point in enumerate(points):
        near = (lower - slack <= point) & (point <= upper + slack)
        candidates = np.flatnonzero(near.all(axis=1))
        if not candidates.size:
            continue
        b = barycentric_in_tets(X[candidates], np.tile(point, (len(candidates), 1)))
        depth = np.nan_to_num(b.min(axis=1), nan=-np.inf)
        best = np.argmax(depth)
        if depth[best] >= -INSIDE:
            tet[i], barycentric[i] = candidates[best], b[best]
    return tet, barycentric


def _nearest_on_boundary(
    mesh: TetMesh, points: HostArray
) -> Iterator[tuple[int, HostArray, float]]:
    """Find the nearest boundary point of each: its tet, coordinates and distance."""
    where = boundary_face_indices(mesh.tets)
    X = mesh.points[tet_faces(mesh.tets)[where]]
    lower, upper = bounds(X)
    for point in points:
        at_least = np.linalg.norm(point - np.clip(point, lower, upper), axis=1)
        reached = np.linalg.norm(X - point, axis=2).min()
        nearest_face, best, nearest = -1, np.zeros(3), np.inf
        # By distance of the bounding boxes, so that most faces are never tried.
        for face in np.argsort(at_least, kind="stable"):
            if at_least[face] > min(reached, nearest):
                break
            b = nearest_on_face(X[face], point)
            x = shape_functions(b, X.shape[1]) @ X[face]
            gap = float(np.linalg.norm(x - point))
            if gap < nearest:
                nearest_face, best, nearest = face, b, gap
        tet, side = divmod(int(where[nearest_face]), 4)
        barycentric = np.zeros(4)
        barycentric[LOCAL_FACES[4][side]] = best
        yield tet, barycentric, nearest


def _too_far(
    mesh: TetMesh,
    points: HostArray,
    distance: HostArray,
    limit: float,
    labels: Sequence[str],
) -> ValueError:
    worst = int(np.argmax(distance))
    where = readable_values(points[worst].tolist(), "m")
    away, allowed = (readable_values([d], "m") for d in (float(distance[worst]), limit))
    far = np.flatnonzero(distance > limit).tolist()
    others = [labels[i] for i in far if i != worst]
    also = ", ".join(others[:40]) + ", ..." * (len(others) > 40)
    check = "Check the frame of the points"
    # Points near the mesh and its origin stay near it, whatever they are divided by.
    if distance[far].min() > mesh.size:
        in_mm = 1e-3 * points[far]
        outside = in_mm[tets_at(mesh, in_mm)[0] < 0]
        if all(gap <= limit for *_, gap in _nearest_on_boundary(mesh, outside)):
            check = "Give the points in metres and not millimetres"
    return ValueError(
        f"{labels[worst]} at {where} lies {away} from the mesh, farther than {allowed}."
        f"{f' So do {also}.' if others else ''} {check}."
    )


_MAX_STEPS = 50
# Newton stops when a step moves the reference point by less than this; it converges
# quadratically, so the error that is left is below rounding.
_STEP = 1e-12


def bounds(
    X: Float[HostArray, "n_cells n_en 3"],
) -> tuple[Float[HostArray, "n_cells 3"], Float[HostArray, "n_cells 3"]]:
    """Find boxes that hold curved tets or triangles entirely.

    A quadratic cell lies in the hull of its Bezier points, not of its nodes.
    """
    hull = bezier_points(X)
    return hull.min(axis=1), hull.max(axis=1)


def bezier_points(
    X: Float[HostArray, "n_cells n_en 3"],
) -> Float[HostArray, "n_cells n_en 3"]:
    """Convert the nodes of tets or triangles to Bezier points, whose hull holds them.

    That of an edge is 2 m - (a + b) / 2 for ends a, b and mid node m.
    """
    n_corners = {3: 3, 4: 4, 6: 3, 10: 4}[X.shape[1]]
    a, b = np.array(TET_EDGES[: X.shape[1] - n_corners], int).reshape(-1, 2).T
    of_edges = 2.0 * X[:, n_corners:] - (X[:, a] + X[:, b]) / 2.0
    return np.concatenate([X[:, :n_corners], of_edges], axis=1)


def barycentric_in_tets(
    X: Float[HostArray, "n n_en 3"], points: Float[HostArray, "n 3"]
) -> Float[HostArray, "n 4"]:
    """Find the barycentric coordinates of one point per tet by Newton's method.

    They are NaN where it does not converge, which on a valid tet happens for points
    outside it only.
    """
    corners = X[:, 1:4] - X[:, :1]
    start = np.linalg.solve(np.swapaxes(corners, 1, 2), (points - X[:, 0])[..., None])
    b = barycentric_of(start[..., 0])
    if X.shape[1] == 4:
        return b
    step = np.zeros((len(X), 3))
    for _ in range(_MAX_STEPS):
        x = np.einsum("na,nai->ni", shape_functions(b, X.shape[1]), X)
        J = np.einsum("nai,naj->nij", X, shape_gradients(b, X.shape[1]))
        J[np.abs(np.linalg.det(J)) < np.finfo(float).tiny] = np.eye(3)
        step = np.linalg.solve(J, (points - x)[..., None])[..., 0]
        # Far outside a curved tet its map folds: keep the iteration near the tet.
        b = barycentric_of(np.clip(b[:, 1:] + step, -1.0, 2.0))
        if (np.abs(step) < _STEP).all():
            break
    b[(np.abs(step) >= 1e-9).any(axis=1)] = np.nan
    return b


def barycentric_of(xi: Float[HostArray, "*points d"]) -> HostArray:
    """Convert reference to barycentric coordinates, which sum to one."""
    return np.concatenate([1.0 - xi.sum(axis=-1, keepdims=True), xi], axis=-1)


def nearest_on_triangles(
    corners: Float[HostArray, "n 3 3"], point: Float[HostArray, "3"]
) -> Float[HostArray, "n 3"]:
    """Find the barycentric coordinates of the nearest point of each flat triangle.

    It is the foot on the plane if that lies inside, else the best of the three edges.
    """
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    w = point - corners[:, 0]
    uu, uv, vv = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)
    wu, wv = (w * u).sum(1), (w * v).sum(1)
    det = np.maximum(uu * vv - uv * uv, np.finfo(float).tiny)
    foot = barycentric_of(
        np.stack([vv * wu - uv * wv, uu * wv - uv * wu], 1) / det[:, None]
    )

    best = foot.copy()
    # A foot inside the triangle wins against every point of an edge.
    gap = np.where((foot >= 0).all(axis=1), -1.0, np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        edge = corners[:, j] - corners[:, i]
        length2 = np.maximum((edge * edge).sum(1), np.finfo(float).tiny)
        t = np.clip(((point - corners[:, i]) * edge).sum(1) / length2, 0.0, 1.0)
        on_edge = np.zeros_like(foot)
        on_edge[:, i], on_edge[:, j] = 1.0 - t, t
        away = ((corners[:, i] + t[:, None] * edge - point) ** 2).sum(1)
        best = np.where((away < gap)[:, None], on_edge, best)
        gap = np.minimum(gap, away)
    return best


_STARTS = np.array([(i, j, 4 - i - j) for i in range(5) for j in range(5 - i)]) / 4.0


def nearest_on_face(
    X: Float[HostArray, "n_fn 3"], point: Float[HostArray, "3"]
) -> Float[HostArray, "3"]:
    """Find the barycentric coordinates of the nearest point of a face.

    On a curved face, the nearest of 15 points of a grid starts a Gauss-Newton
    iteration: each step goes to the nearest point of the tangent triangle, halved until
    the distance falls.
    """
    if len(X) == 3:
        return nearest_on_triangles(X[None], point)[0]

    def squared(b):
        return ((shape_functions(b, 6) @ X - point) ** 2).sum(axis=-1)

    best = _STARTS[np.argmin(squared(_STARTS))]
    corners = np.eye(3)
    for _ in range(_MAX_STEPS):
        x = shape_functions(best, 6) @ X
        J = shape_gradients(best, 6).T @ X
        tangent = x + (corners - best)[:, 1:] @ J
        step = nearest_on_triangles(tangent[None], point)[0] - best
        lengths = 0.5 ** np.arange(20)
        trials = best + lengths[:, None] * step
        falls = squared(trials) < squared(best)
        if not falls.any():
            break
        best = trials[np.argmax(falls)]
        if np.abs(step).max() < _STEP:
            break
    return best
