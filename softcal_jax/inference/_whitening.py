"""Errors with a common covariance made independent, on the host or in a program.

With the covariance s^2 (I + B B^T) of few columns B, (I + B B^T)^-1/2 makes errors
independent, each with the standard deviation s (generalised least squares; Seber and Wild,
Nonlinear Regression, 1989, sec. 2.1.4).
"""

from typing import NamedTuple, overload

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import one_line
from softcal_jax._typing import Array, Float, HostArray

AnyArray = Array | HostArray


class Whitened(NamedTuple):
    """Rows of a least-squares problem, min ||error + W dz||, all equally certain.

    Distances from priors are rows like any other, behind those of the data.

    Attributes:
        error: The errors [-].
        W: Their change per unit of lambda_p [-].
    """

    error: Float[AnyArray, " n"]
    W: Float[AnyArray, "n n_p"]

    __repr__ = one_line


@overload
def whitened(B: HostArray, x: HostArray) -> HostArray: ...


@overload
def whitened(B: Array, x: Array) -> Array: ...


def whitened(
    B: Float[AnyArray, "n n_columns"], x: Float[AnyArray, "n ..."]
) -> Float[AnyArray, "n ..."]:
    """Compute (I + B B^T)^-1/2 x.

    With B^T B = P diag(b^2) P^T and r = sqrt(1 + b^2) it is
    x - B P diag(1 / (r (1 + r))) P^T B^T x, which is regular at b = 0.
    """
    xp = jnp if isinstance(B, jax.Array) else np
    square, P = xp.linalg.eigh(B.T @ B)
    root = xp.sqrt(1.0 + xp.maximum(square, 0.0))
    along = (P / (root * (1.0 + root))[None, :]) @ (P.T @ (B.T @ x))
    return x - B @ along


def whitened_rows(
    B: Float[AnyArray, "n n_columns"],
    *,
    error: Float[AnyArray, " n"],
    W: Float[AnyArray, "n n_p"],
    from_prior: Float[AnyArray, " n_p"],
    prior_weights: Float[AnyArray, " n_p"],
) -> Whitened:
    """Whiten errors of data, and put those of priors behind them.

    Args:
        B: Correlated columns, over the standard deviation of the independent errors.
        error: Errors in stated standard deviations [-].
        W: Their change per unit of lambda_p [-].
        from_prior: Distances from the priors, in the same unit [-].
        prior_weights: Their change per unit of lambda_p [-].
    """
    xp = jnp if isinstance(B, jax.Array) else np
    both = whitened(B, xp.concatenate([error[:, None], W], axis=1))
    return Whitened(
        xp.concatenate([both[:, 0], from_prior]),
        xp.concatenate([both[:, 1:], xp.diag(prior_weights)]),
    )
