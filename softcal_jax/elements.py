"""Reference elements, and the 3x3 tensor algebra that the laws are written in.

One formula serves lines, triangles and tets: in barycentric coordinates the linear
functions are L_i, the quadratic ones L_i (2 L_i - 1) at corners and 4 L_i L_j on edges
(Zienkiewicz and Taylor, The Finite Element Method, ch. 8). Node order is VTK's: corners
first, then the edges of `TET_EDGES`.

Algebra is that of single 3x3 tensors, written out so that it vectorises under `vmap`.
Batched `@`, `inv`, `svd` and `eigh` of tiny matrices call a library routine per matrix
on every backend. Sums of products that are written out fuse into the loop over tets;
XLA turns a reduction inside a product over tets into scalar code.
"""

from collections.abc import Iterable
from functools import reduce
from itertools import combinations
from operator import add
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray

TET_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
"""Corner pairs of the edge nodes 4 to 9 of a quadratic tet."""

TET_FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
"""Corners of the four faces, ordered so that the normal points outwards."""

_EDGES = {2: ((0, 1),), 3: ((0, 1), (1, 2), (2, 0)), 4: TET_EDGES}


def _corners_and_edges(n_nodes: int, n_corners: int):
    edges = _EDGES[n_corners]
    if n_nodes not in (n_corners, n_corners + len(edges)):
        raise ValueError(
            f"a simplex with {n_corners} corners has {n_corners} (linear) or "
            f"{n_corners + len(edges)} (quadratic) nodes, got {n_nodes}."
        )
    return edges if n_nodes > n_corners else ()


def shape_functions(
    barycentric: Float[HostArray, "*points n_corners"], n_nodes: int
) -> Float[HostArray, "*points n_nodes"]:
    """Evaluate the shape functions at points of a simplex, corners first [-].

    Rows of barycentric coordinates sum to one; coordinates outside [0, 1] extrapolate.
    An edge has 2 or 3 nodes, a triangle 3 or 6, a tet 4 or 10.

    Raises:
        ValueError: If no simplex of that dimension has `n_nodes` nodes.
    """
    n_corners = barycentric.shape[-1]
    edges = _corners_and_edges(n_nodes, n_corners)
    if not edges:
        return np.array(barycentric, dtype=float)
    corner = barycentric * (2.0 * barycentric - 1.0)
    mid = [4.0 * barycentric[..., i] * barycentric[..., j] for i, j in edges]
    return np.concatenate([corner, np.stack(mid, axis=-1)], axis=-1)


def shape_gradients(
    barycentric: Float[HostArray, "*points n_corners"], n_nodes: int
) -> Float[HostArray, "*points n_nodes n_dim"]:
    """Compute dN_a / d xi_j, shape functions by reference coordinates [-].

    The reference coordinates are L_1, ..., L_d, with L_0 = 1 - sum(L_1..L_d).

    Raises:
        ValueError: If no simplex of that dimension has `n_nodes` nodes.
    """
    n_corners = barycentric.shape[-1]
    edges = _corners_and_edges(n_nodes, n_corners)
    dL = np.vstack([-np.ones(n_corners - 1), np.eye(n_corners - 1)])
    if not edges:
        return np.broadcast_to(dL, (*barycentric.shape[:-1], *dL.shape)).copy()
    corner = (4.0 * barycentric[..., None] - 1.0) * dL
    mid = [
        4.0 * (barycentric[..., i, None] * dL[j] + barycentric[..., j, None] * dL[i])
        for i, j in edges
    ]
    return np.concatenate([corner, np.stack(mid, axis=-2)], axis=-2)


class QuadratureRule(NamedTuple):
    """Points and weights on a reference simplex; weights sum to one."""

    barycentric: Float[HostArray, "n_points n_corners"]
    weights: Float[HostArray, " n_points"]


def _permuted(n_corners: int, inner: float) -> HostArray:
    """Return one point per corner: its other coordinates are `inner`; all sum to 1."""
    points = np.full((n_corners, n_corners), inner)
    np.fill_diagonal(points, 1.0 - (n_corners - 1) * inner)
    return points


def tet_rule(degree: int) -> QuadratureRule:
    """Return the rule on the tet that is exact for polynomials of `degree`, 1 to 4.

    Degree 1: the centroid. Degree 2: the four-point rule. Degree 3 and 4: the
    eleven-point rule of Keast (Comput. Methods Appl. Mech. Eng. 55, 1986).

    Raises:
        ValueError: If there is no rule of that degree.
    """
    if degree == 1:
        return QuadratureRule(np.full((1, 4), 0.25), np.ones(1))
    if degree == 2:
        inner = (5.0 - np.sqrt(5.0)) / 20.0
        return QuadratureRule(_permuted(4, inner), np.full(4, 0.25))
    if degree in (3, 4):
        a, b = (1.0 + np.sqrt(5.0 / 14.0)) / 4.0, (1.0 - np.sqrt(5.0 / 14.0)) / 4.0
        edge = np.full((6, 4), b)
        for row, pair in enumerate(combinations(range(4), 2)):
            edge[row, pair] = a
        points = np.vstack([np.full((1, 4), 0.25), _permuted(4, 1.0 / 14.0), edge])
        weights = [-148.0 / 1875.0] + [343.0 / 7500.0] * 4 + [56.0 / 375.0] * 6
        return QuadratureRule(points, np.array(weights))
    raise ValueError(f"tet rules exist for degree 1 to 4, got {degree}.")


def triangle_rule(degree: int) -> QuadratureRule:
    """Return the rule on the triangle, exact for polynomials of `degree`, 1 to 4.

    Degree 1: the centroid. Degree 2 to 4: the six-point rule of Dunavant (Int. J.
    Numer. Methods Eng. 21, 1985).

    Raises:
        ValueError: If there is no rule of that degree.
    """
    if degree == 1:
        return QuadratureRule(np.full((1, 3), 1.0 / 3.0), np.ones(1))
    if degree in (2, 3, 4):
        inner = 0.445948490915965, 0.091576213509771
        points = np.vstack([_permuted(3, a) for a in inner])
        weights = np.array([0.223381589678011] * 3 + [0.109951743655322] * 3)
        return QuadratureRule(points, weights / weights.sum())
    raise ValueError(f"triangle rules exist for degree 1 to 4, got {degree}.")


def sum_of(terms: Iterable[Array]) -> Array:
    """Add up at least one term."""
    return reduce(add, terms)


def vector_length(v: Float[Array, " n"]) -> Float[Array, ""]:
    """Compute the length of a vector, with the derivative 0 where it vanishes.

    The derivative of the root is not finite there.
    """
    square = jnp.sum(v * v)
    positive = square > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def determinant(F: Float[Array, "3 3 *many"]) -> Float[Array, "*many"]:
    """Compute the determinant, also of many matrices along further axes."""
    (a, b, c), (d, e, f), (g, h, i) = map(jnp.unstack, jnp.unstack(F))
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def cofactor(F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Compute the cofactor matrix det(F) F^-T, the derivative of the determinant.

    By rows, since XLA compiles every entry that is written out.
    """
    twice = jnp.concatenate([F, F], axis=1)
    a, b = jnp.unstack(twice[:, 1:4]), jnp.unstack(twice[:, 2:5])
    return jnp.stack([a[i - 2] * b[i - 1] - b[i - 2] * a[i - 1] for i in range(3)])


def matmul(A: Float[Array, "3 3"], B: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Multiply A B."""
    # A reduction: a written sum would compute A and B again for each of its terms.
    return jnp.sum(A[:, :, None] * B[None, :, :], axis=1)


def axial(A: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Return twice the axial vector of the skew part: [A32-A23, A13-A31, A21-A12]."""
    (_, b, c), (d, _, f), (g, h, _) = map(jnp.unstack, jnp.unstack(A))
    return jnp.stack([h - f, c - g, d - b])


def skew(a: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Return the skew matrix hat(a) with hat(a) b = a x b."""
    (x, y, z), zero = jnp.unstack(a), jnp.zeros_like(a[0])
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return jnp.stack([jnp.stack(row) for row in rows])


def _scaled_newton_step(R: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    C = cofactor(R)
    det = jnp.sum(R[0] * C[0])
    # The scaling of Higham (SIAM J. Sci. Stat. Comput. 7, 1986), in its
    # Frobenius form: it makes the number of steps nearly independent of F.
    gamma = jnp.sqrt(jnp.sqrt(jnp.sum(C * C) / (det * det) / jnp.sum(R * R)))
    return 0.5 * (gamma * R + C / (gamma * det))


# Nine scaled steps bring every F of condition up to 1e8 to rounding; five, without
# scaling, leave a tangent that is wrong by its own size at large deformation.
_POLAR_STEPS = 9


@jax.custom_jvp
def rotation(F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Compute the rotation R of the polar decomposition F = R S by Newton's iteration.

    Higham, "Computing the polar decomposition", SIAM J. Sci. Stat. Comput. 7 (1986).
    The derivative is the closed form dR = R hat(M^-1 axial(R^T dF)) with
    M = tr(S) I - S, not that of the iteration. F is non-singular [-]; R is a proper
    rotation where det F > 0.
    """
    return jax.lax.fori_loop(0, _POLAR_STEPS, lambda _, R: _scaled_newton_step(R), F)


@rotation.defjvp
def _rotation_jvp(primals, tangents):
    (F,), (dF,) = primals, tangents
    R = rotation(F)
    S = matmul(R.T, F)
    M = jnp.trace(S) * jnp.eye(3) - S
    C = cofactor(M)  # Cramer's rule
    det = jnp.sum(M[0] * C[0])
    omega = jnp.sum(C * axial(matmul(R.T, dF))[:, None], axis=0) / det
    return R, matmul(R, skew(omega))


def symmetric(A: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Return the symmetric part."""
    return 0.5 * (A + A.T)
