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
    return (
        F[0, 0] * (F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1])
        - F[0, 1] * (F[1, 0] * F[2, 2] - F[1, 2] * F[2, 0])
        + F[0, 2] * (F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0])
    )


def cofactor(F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Compute the cofactor matrix det(F) F^-T, the derivative of the determinant.

    By rows, since XLA compiles every entry that is written out.
    """
    twice = jnp.concatenate([F, F], axis=1)
    a, b = twice[:, 1:4], twice[:, 2:5]
    rows = [a[i - 2] * b[i - 1] - b[i - 2] * a[i - 1] for i in range(3)]
    return jnp.stack(rows)


def matmul(A: Float[Array, "3 3"], B: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Multiply A B."""
    # A reduction: a written sum would compute A and B again for each of its terms.
    return jnp.sum(A[:, :, None] * B[None, :, :], axis=1)


def axial(A: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Return twice the axial vector of the skew part: [A32-A23, A13-A31, A21-A12]."""
    return jnp.stack([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])


def skew(a: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Return the skew matrix hat(a) with hat(a) b = a x b."""
    zero = jnp.zeros_like(a[0])
    rows = [[zero, -a[2], a[1]], [a[2], zero, -a[0]], [-a[1], a[0], zero]]
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
