"""The distance of a point from a face of the body, with its derivatives.

With the nearest point y of the face, the normal n there and a = (x - y) . n,

    g = a            where y lies inside of the face;
        |x - y|      where y lies on its edge, and x above,
        (b^2 - a^2) / (b^2 + a^2)^0.5  below, with b = (1 - a / s) |x - y - a n|

and the scale s of contact, so that g is continuous where the nearest face of a surface
changes, and a point beside a surface that ends has left it. A face is a polynomial of
the two coordinates of its reference triangle.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.elements import vector_length

_GUESSES = 4  # steps to the foot of a point on a curved face, before the exact ones

_NODES = ((0, 0), (1, 0), (0, 1), (0.5, 0), (0.5, 0.5), (0, 0.5))


def _to_polynomial(n_fn: int) -> Float[HostArray, "6 n_fn"]:
    """Map places of nodes to coefficients of 1, a, b, a^2, a b and b^2 on a face."""
    a, b = np.transpose(_NODES[:n_fn])
    terms = np.stack([np.ones(n_fn), a, b, a * a, a * b, b * b][:n_fn], axis=1)
    return np.pad(np.linalg.inv(terms), ((0, 6 - n_fn), (0, 0)))


def polynomial(Y: Float[Array, "n_fn 3"]) -> Float[Array, "6 3"]:
    return jnp.asarray(_to_polynomial(len(Y))) @ Y


def _place(C: Float[Array, "6 3"], t: Float[Array, "2"]):
    """Return a place on a face, and its tangents there [m]."""
    a, b = t
    y = C[0] + a * (C[1] + a * C[3] + b * C[4]) + b * (C[2] + b * C[5])
    return y, C[1] + 2.0 * a * C[3] + b * C[4], C[2] + a * C[4] + 2.0 * b * C[5]


def _step(C, x, t, *, exact: bool) -> Float[Array, "2"]:
    """Do a step of Newton's method, or of Gauss and Newton, to the foot of a point."""
    y, p, q = _place(C, t)
    r = x - y
    h, k = jnp.sum(r * p), jnp.sum(r * q)
    pp, pq, qq = jnp.sum(p * p), jnp.sum(p * q), jnp.sum(q * q)
    flat = pp * qq - pq * pq
    if exact:
        bend = jnp.sum(C[3:] * r[None], axis=1)
        a, b, c = pp - 2.0 * bend[0], pq - bend[1], qq - 2.0 * bend[2]
        # Beyond the centre of curvature there is no nearest point.
        near = a * c - b * b > 0.1 * flat
        pp, pq, qq = (jnp.where(near, *both) for both in ((a, pp), (b, pq), (c, qq)))
        flat = pp * qq - pq * pq
    return t + jnp.stack([qq * h - pq * k, pp * k - pq * h]) / flat


class Placed(NamedTuple):
    """Where a point lies from a face: g, a and |x - y| [m].

    `inside` tells whether y lies inside of the face.
    """

    gap: Float[Array, ""]
    along: Float[Array, ""]
    away: Float[Array, ""]
    inside: Bool[Array, ""]


def placed(C, x, t, s: Float[Array, ""]) -> Placed:
    """Tell where a point lies from a face, of which it knows the foot."""
    b = jnp.stack([1.0 - t[0] - t[1], t[0], t[1]])
    # A foot on an edge, as matching meshes have, is inside for both faces.
    inside, within = jnp.all(b >= -1e-9), jnp.maximum(b, 0.0)
    y, p, q = _place(C, jnp.where(inside, t, within[1:] / jnp.sum(within)))
    n, r = jnp.cross(p, q), x - y
    n = n / vector_length(n)
    along = jnp.sum(r * n)
    away, down = vector_length(r), along**2
    beside = jnp.sum((r - along * n) ** 2) * (1.0 - along / s) ** 2
    below = (beside - down) / jnp.sqrt(jnp.maximum(beside + down, 1e-30 * s * s))
    gap = jnp.where(inside, along, jnp.where(along > 0.0, away, below))
    return Placed(gap, along, away, inside)


def foot(C, x) -> Float[Array, "2"]:
    # Far from a curved face its map folds: keep near the face.
    nearer = lambda _, t: jnp.clip(_step(C, x, t, exact=False), -1.0, 2.0)
    return jax.lax.fori_loop(0, _GUESSES, nearer, jnp.full(2, 1.0 / 3.0))


def _exact(C, x, t, n_fn: int) -> Float[Array, "2"]:
    """Return a foot that is nearly known, with its derivatives: by Newton's method."""
    for _ in range(1 if n_fn == 3 else 2):
        t = _step(C, x, t, exact=True)
    return t


def gap_of(N, s, t, z: Float[Array, "m 3"]) -> Float[Array, ""]:
    """Compute g of a point at the nodes z of its face, then of the other [m]."""
    n = len(N)
    x, C = jnp.sum(N[:, None] * z[:n], axis=0), polynomial(z[n:])
    return placed(C, x, _exact(C, x, t, n), s).gap


def stiffness_of(law, N, s, t, z) -> Float[Array, "m 3 m 3"]:
    """Differentiate law(s / 2 - g) grad g, with its sign turned, by the nodes z.

    Its foot follows from h = 0. Instead of the second derivatives of the foot, those of
    the Lagrangian g + mu . h are taken along its first ones.
    """
    n = len(N)
    x, C = jnp.sum(N[:, None] * z[:n], axis=0), polynomial(z[n:])
    t = _exact(C, x, t, n)
    v = jnp.concatenate([x, C.ravel(), t])
    cut = lambda v: (v[3:21].reshape(6, 3), v[:3], v[21:])

    def h(v):
        C, x, t = cut(v)
        y, *tangents = _place(C, t)
        return jnp.stack([jnp.sum(tangent * (x - y)) for tangent in tangents])

    gap = lambda v: placed(*cut(v), s).gap
    g, slope = jax.value_and_grad(gap)(v)
    of_h = jax.jacfwd(h)(v)
    (a, b), (c, d) = of_h[:, 21:]
    inverse = jnp.stack([jnp.stack([d, -b]), jnp.stack([-c, a])]) / (a * d - b * c)
    follows = -jnp.sum(inverse[:, :, None] * of_h[None, :, :21], axis=1)
    mu = -jnp.sum(slope[21:, None] * inverse, axis=0)
    bend = jax.hessian(lambda v: gap(v) + jnp.sum(mu * h(v)))(v)
    P = jnp.concatenate([jnp.eye(21), follows])
    slope, bend = slope @ P, P.T @ bend @ P
    p, dp = jax.value_and_grad(law)(0.5 * s - g, s)
    K = (dp * slope[:, None] * slope[None] - p * bend).reshape(7, 3, 7, 3)
    none = np.zeros((6, n))
    of_face = jnp.concatenate([N, jnp.zeros(n)])[None]
    B = jnp.concatenate([of_face, np.hstack([none, _to_polynomial(n)])])
    return jnp.einsum("ra,rich,cb->aibh", B, K, B)
