"""Products that make fourth-order tensors A_iJkL, for tangents."""

import jax

from softcal_jax._typing import Array, Float
from softcal_jax.elements import sum_of

Matrix = Float[Array, "3 3"]
Tensor = Float[Array, "3 3 3 3"]


def outer(X: Matrix, Y: Matrix) -> Tensor:
    """Multiply X_iJ Y_kL."""
    return X[:, :, None, None] * Y[None, None]


def crossed(X: Matrix, Y: Matrix) -> Tensor:
    """Multiply X_iL Y_kJ."""
    return X[:, None, None, :] * Y.T[None, :, :, None]


def paired(X: Matrix, Y: Matrix) -> Tensor:
    """Multiply X_ik Y_JL."""
    return X[:, None, :, None] * Y[None, :, None, :]


def turned(C: Tensor, G: Matrix) -> Tensor:
    """Transform the first index of each pair, G_iM C_MJNL G_kN."""
    # Barriers stop XLA from recomputing C and `half` for each entry of the result.
    C = jax.lax.optimization_barrier(C)
    half = sum_of(C[:, :, None, N, :] * G[None, None, :, N, None] for N in range(3))
    half = jax.lax.optimization_barrier(half)
    return sum_of(G[:, M, None, None, None] * half[None, M] for M in range(3))
