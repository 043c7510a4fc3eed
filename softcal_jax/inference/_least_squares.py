"""Least squares: what rows determine, and errors with a common covariance.

One rule serves every rank in the statistics. A column that is smaller than `NO_EFFECT`
times the largest is what a factorization leaves of zero. The others are scaled to unit
length, so that the unit of an unknown decides nothing, and a direction is seen if its
singular value is above `RANK` times the largest. Compliances are exact to about 1e-9,
and their squares, which weigh a direction, to the square root of that; what lies below
a millionth is rounding, and an error a million times that of the best direction is no
knowledge.

With the covariance s^2 (I + B B^T) of few columns B, (I + B B^T)^-1/2 makes errors
independent, each with the standard deviation s (generalised least squares; Seber and
Wild, Nonlinear Regression, 1989, sec. 2.1.4).
"""

from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, HostArray

NO_EFFECT = 1e-12
"""Length of a column, over the largest, below which it has no effect [-]."""

RANK = 1e-6
"""Singular value of columns of unit length, over the largest, that is rounding [-]."""


class Determined(Module):
    """What rows R determine of the unknowns, (R^T R)^-1 = F F^T along what is seen.

    Attributes:
        factor: F, one column per direction that is seen.
        basis: Orthonormal basis of the column space, R F in exact arithmetic.
        unseen: Orthonormal directions of the unknowns that no row sees, as rows.
        blind: Unknowns with a component in one of these.
    """

    factor: Float[HostArray, "n_unknowns rank"]
    basis: Float[HostArray, "n rank"]
    unseen: Float[HostArray, "n_unseen n_unknowns"]
    blind: Bool[HostArray, " n_unknowns"]


def determined(rows: Float[HostArray, "n n_unknowns"]) -> Determined:
    """Decompose rows, all finite, by the rule of this module."""
    n, n_unknowns = rows.shape
    size = np.linalg.norm(rows, axis=0)
    active = np.flatnonzero(size > NO_EFFECT * np.max(size, initial=0.0))
    unit = rows[:, active] / size[active]
    # At least as many rows as columns, so that directions without a row are listed.
    padding = np.zeros((max(0, len(active) - n), len(active)))
    U, singular, Vt = np.linalg.svd(
        np.concatenate([unit, padding]), full_matrices=False
    )
    seen = singular > RANK * np.max(singular, initial=0.0)
    factor = np.zeros((n_unknowns, int(seen.sum())))
    factor[active] = Vt[seen].T / singular[seen] / size[active, None]
    blind = np.ones(n_unknowns, bool)
    blind[active] = np.max(np.abs(Vt[~seen]), axis=0, initial=0.0) > RANK
    astray = np.zeros((int((~seen).sum()), n_unknowns))
    astray[:, active] = Vt[~seen] / size[active]
    without_effect = np.delete(np.eye(n_unknowns), active, axis=0)
    unseen, _ = np.linalg.qr(np.concatenate([astray, without_effect]).T)
    return Determined(factor, U[:n, seen], unseen.T, blind)


def span(columns: Float[HostArray, "n k"]) -> Float[HostArray, "n rank"]:
    """Return an orthonormal basis of the space that columns span."""
    return determined(columns).basis


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
    prior_rows: OneKind,
) -> Whitened:
    """Whiten errors of data, and put those of priors behind them.

    Args:
        B: Correlated columns, over the standard deviation of the independent errors.
        error: Errors in stated standard deviations [-].
        W: Their change per unit of lambda_p [-].
        from_prior: Distances from the priors, in the same unit [-].
        prior_rows: Their change per unit of lambda_p [-].
    """
    xp: Any = jnp if isinstance(B, jax.Array) else np
    both = whitened(B, xp.concatenate([error[:, None], W], axis=1))
    return Whitened(
        xp.concatenate([both[:, 0], from_prior]),
        xp.concatenate([both[:, 1:], prior_rows]),
    )
