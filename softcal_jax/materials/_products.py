"""Fourth-order tensors A_iJkL from products of small ones, as tangents need them.

Sums are written out: XLA turns a reduction inside a product over tets into scalar code.
"""

from collections.abc import Iterable
from functools import reduce
from operator import add

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.materials._elasticity import AbstractElasticity


def sum_of(terms: Iterable[Array]) -> Array:
    """Sum of at least one term."""
    return reduce(add, terms)


def outer(X: Float[Array, "3 3"], Y: Float[Array, "3 3"]) -> Float[Array, "3 3 3 3"]:
    """Product X_iJ Y_kL."""
    return X[:, :, None, None] * Y[None, None]


def crossed(X: Float[Array, "3 3"], Y: Float[Array, "3 3"]) -> Float[Array, "3 3 3 3"]:
    """Product X_iL Y_kJ."""
    return X[:, None, None, :] * Y.T[None, :, :, None]


def paired(X: Float[Array, "3 3"], Y: Float[Array, "3 3"]) -> Float[Array, "3 3 3 3"]:
    """Product X_ik Y_JL."""
    return X[:, None, :, None] * Y[None, :, None, :]


_UNIT = np.eye(9).reshape(3, 3, 3, 3)
_SYMMETRIC_UNIT = 0.5 * (_UNIT + _UNIT.transpose(1, 0, 2, 3))


def turned_stiffness(
    elasticity: AbstractElasticity, G: Float[Array, "3 3"]
) -> Float[Array, "3 3 3 3"]:
    """Stiffness with its first slot of each pair turned, G_iM C_MJNL G_kN [Pa]."""
    C = jax.vmap(jax.vmap(elasticity.stress))(jnp.asarray(_SYMMETRIC_UNIT))
    half = sum_of(C[:, :, None, N, :] * G[None, None, :, N, None] for N in range(3))
    half = jax.lax.optimization_barrier(half)  # not again for each i
    return sum_of(G[:, M, None, None, None] * half[None, M] for M in range(3))
