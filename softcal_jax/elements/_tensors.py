"""Algebra of single 3x3 tensors, written out so that it vectorises under `vmap`.

Batched `@`, `inv`, `svd` and `eigh` of tiny matrices call a library routine per matrix
on every backend. Sums of products that are written out fuse into the loop over tets;
XLA turns a reduction inside a product over tets into scalar code.
"""

from collections.abc import Iterable
from functools import reduce
from operator import add

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float


def sum_of(terms: Iterable[Array]) -> Array:
    """Add up at least one term."""
    return reduce(add, terms)


def determinant(F: Float[Array, "3 3"]) -> Float[Array, ""]:
    """Compute the determinant."""
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
