"""Coordinates of a point of space in an element: inside a tet, or nearest on a face.

VTK's locators do the same, but their inverse map of a quadratic tet stops at an error
of 3e-7 m on a mesh of 0.1 m, where this one ends in rounding, and they take a curved
face for flat triangles, which misses the nearest point by up to 1e-4 m.
"""

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.elements import TET_EDGES, shape_functions, shape_gradients

_MAX_STEPS = 50
# Newton stops when a step moves the reference point by less than this; it converges
# quadratically, so the error that is left is below rounding.
_STEP = 1e-12


def bounds(
    X: Float[HostArray, "n_cells n_en 3"],
) -> tuple[Float[HostArray, "n_cells 3"], Float[HostArray, "n_cells 3"]]:
    """Find boxes that hold curved tets or triangles entirely.

    A quadratic cell lies in the hull of its Bezier points, not of its nodes: the
    Bezier point of an edge is 2 m - (a + b) / 2 for ends a, b and mid node m.
    """
    n_corners = {3: 3, 4: 4, 6: 3, 10: 4}[X.shape[1]]
    hull = X
    if X.shape[1] > n_corners:
        edges = np.array(TET_EDGES[: X.shape[1] - n_corners])
        ends = X[:, edges].sum(axis=2) / 2.0
        hull = np.concatenate([X[:, :n_corners], 2.0 * X[:, n_corners:] - ends], axis=1)
    return hull.min(axis=1), hull.max(axis=1)


def barycentric_in_tets(
    X: Float[HostArray, "n n_en 3"], points: Float[HostArray, "n 3"]
) -> Float[HostArray, "n 4"]:
    """Find the barycentric coordinates of one point per tet by Newton's method.

    They are NaN where it does not converge, which on a valid tet happens for points
    outside it only.
    """
    corners = X[:, 1:4] - X[:, :1]
    start = np.linalg.solve(np.swapaxes(corners, 1, 2), (points - X[:, 0])[..., None])
    b = _full(start[..., 0])
    if X.shape[1] == 4:
        return b
    step = np.zeros((len(X), 3))
    # Far outside a curved tet its map folds: keep the iteration near the tet.
    for _ in range(_MAX_STEPS):
        step = _newton_step(X, b, points)
        b = _full(np.clip(b[:, 1:] + step, -1.0, 2.0))
        if (np.abs(step) < _STEP).all():
            break
    b[(np.abs(step) >= 1e-9).any(axis=1)] = np.nan
    return b


def _full(xi: HostArray) -> HostArray:
    return np.concatenate([1.0 - xi.sum(axis=-1, keepdims=True), xi], axis=-1)


def _newton_step(X: HostArray, b: HostArray, points: HostArray) -> HostArray:
    x = np.einsum("na,nai->ni", shape_functions(b, X.shape[1]), X)
    J = np.einsum("nai,naj->nij", X, shape_gradients(b, X.shape[1]))
    singular = np.abs(np.linalg.det(J)) < np.finfo(float).tiny
    J[singular] = np.eye(3)
    return np.linalg.solve(J, (points - x)[..., None])[..., 0]


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
    foot = _full(np.stack([vv * wu - uv * wv, uu * wv - uv * wu], 1) / det[:, None])

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
