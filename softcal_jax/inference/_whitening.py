"""Errors with a common covariance made independent, on the host or in a program.

With the covariance s^2 (I + B B^T) of few columns B, (I + B B^T)^-1/2 makes errors
independent, each with the standard deviation s (generalised least squares; Seber and
Wild, Nonlinear Regression, 1989, sec. 2.1.4).
"""

from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray

AnyArray = Array | HostArray
OneKind = TypeVar("OneKind", Array, HostArray)
"""Arrays of JAX or of NumPy, but not of both."""


class Whitened(NamedTuple):
    """Rows of a least-squares problem, min ||error + W dz||, all equally certain.

    Distances from priors are rows like any other, behind those of the data.

    Attributes:
        error: The errors [-].
        W: Their change per unit of lambda_p [-].
    """

    error: Float[AnyArray, " n"]
    W: Float[AnyArray, "n n_p"]


def whitened(B: OneKind, x: OneKind) -> OneKind:
    """Compute (I + B B^T)^-1/2 x.

    With B^T B = P diag(b^2) P^T and r = sqrt(1 + b^2) it is
    x - B P diag(1 / (r (1 + r))) P^T B^T x, which is regular at b = 0.
    """
    xp: Any = jnp if isinstance(B, jax.Array) else np
    square, P = xp.linalg.eigh(B.T @ B)
    root = xp.sqrt(1.0 + xp.maximum(square, 0.0))
    along = (P / (root * (1.0 + root))[None, :]) @ (P.T @ (B.T @ x))
    return x - B @ along


def whitened_rows(
    B: OneKind,
    *,
    error: OneKind,
    W: OneKind,
    from_prior: OneKind,
    prior_weights: OneKind,
) -> Whitened:
    """Whiten errors of data, and put those of priors behind them.

    Args:
        B: Correlated columns, over the standard deviation of the independent errors.
        error: Errors in stated standard deviations [-].
        W: Their change per unit of lambda_p [-].
        from_prior: Distances from the priors, in the same unit [-].
        prior_weights: Their change per unit of lambda_p [-].
    """
    xp: Any = jnp if isinstance(B, jax.Array) else np
    both = whitened(B, xp.concatenate([error[:, None], W], axis=1))
    return Whitened(
        xp.concatenate([both[:, 0], from_prior]),
        xp.concatenate([both[:, 1:], xp.diag(prior_weights)]),
    )
