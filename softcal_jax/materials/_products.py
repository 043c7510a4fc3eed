"""Fourth-order tensors A_iJkL from products of small ones, as tangents need them."""

import jax

from softcal_jax._typing import Array, Float
from softcal_jax.elements import sum_of


def outer(X: Float[Array, "3 3"], Y: Float[Array, "3 3"]) -> Float[Array, "3 3 3 3"]:
    """Product X_iJ Y_kL."""
    return X[:, :, None, None] * Y[None, None]


def crossed(X: Float[Array, "3 3"], Y: Float[Array, "3 3"]) -> Float[Array, "3 3 3 3"]:
    """Product X_iL Y_kJ."""
    return X[:, None, None, :] * Y.T[None, :, :, None]


def paired(X: Float[Array, "3 3"], Y: Float[Array, "3 3"]) -> Float[Array, "3 3 3 3"]:
    """Product X_ik Y_JL."""
    return X[:, None, :, None] * Y[None, :, None, :]


def turned(
    C: Float[Array, "3 3 3 3"], G: Float[Array, "3 3"]
) -> Float[Array, "3 3 3 3"]:
    """Tensor with the first slot of each pair turned, G_iM C_MJNL G_kN."""
    C = jax.lax.optimization_barrier(C)  # not again for each k and i
    half = sum_of(C[:, :, None, N, :] * G[None, None, :, N, None] for N in range(3))
    half = jax.lax.optimization_barrier(half)
    return sum_of(G[:, M, None, None, None] * half[None, M] for M in range(3))
