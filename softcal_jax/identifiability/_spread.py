"""Spread of the parameters given noise and prior, and the verdict on it."""

from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.fields import ParameterSpace

Verdict = Literal["identifiable", "weakly identifiable", "not identifiable"]

IDENTIFIABLE_BELOW = 0.1
"""Spread below which a parameter is identifiable [-].

The spread is the predicted standard deviation over the prior one. At 0.1 the data hold
99 % of the information, and the standard deviation is 2.9 % of the range.
"""

WEAK_BELOW = 0.5
"""Spread above which a parameter is not identifiable [-].

At 0.5 the data hold three quarters of the information; above it, the value depends too
much on the bounds that the user chose.
"""

BLIND = 1e-6
"""Relative singular value below which a direction is only rounding [-].

It applies to a matrix with columns of unit length, as in `calibration.uncertainty`.
"""

VANISHED = 1e-12
"""Relative sensitivity below which a parameter has no effect [-]."""


def verdict(spread: float) -> Verdict:
    """Judge a spread, the predicted over the prior standard deviation [-]."""
    if spread < IDENTIFIABLE_BELOW:
        return "identifiable"
    return "weakly identifiable" if spread <= WEAK_BELOW else "not identifiable"


def prior_std(space: ParameterSpace) -> Float[HostArray, " n_p"]:
    """Compute the standard deviation of the scaled parameters before any data [-].

    It is that of a uniform density between the bounds, or the `prior_std` of the
    parameter if that is smaller.
    """
    bounds = np.asarray(space.upper() - space.lower()) / np.sqrt(12.0)
    weights = np.asarray(space.prior_weights())
    return 1.0 / np.maximum(1.0 / bounds, weights)


def posterior(G: Float[HostArray, "n_e n_p"]) -> Float[HostArray, "n_p n_p"]:
    """Compute the covariance (I + G^T G)^-1 in units of the prior standard deviations.

    Linear-Gaussian Bayes (Tarantola, Inverse Problem Theory, 2005, ch. 3): the Fisher
    information of the data plus that of the prior, so the inverse always exists.

    Args:
        G: Noise-weighted compliances per prior standard deviation: signal to noise.

    Returns:
        The covariance [-]; a blind direction keeps a variance of one.
    """
    _, singular, Vt = np.linalg.svd(G)
    variance = np.ones(G.shape[1])
    variance[: len(singular)] = np.hypot(1.0, singular) ** -2.0
    return (Vt.T * variance) @ Vt


def marginalised(
    G: Float[HostArray, "n_e n_p"], W_c: Float[HostArray, "n_e n_errors"]
) -> Float[HostArray, "n n_p"]:
    """Find compliances that would tell as much if the noise were the only error.

    With C = (I + G^T G)^-1 the errors W_c move the parameters by D = C G^T W_c, so that
    their covariance is T = C + D D^T. The result R has the same, (I + R^T R)^-1 = T,
    where T is not larger than that of the prior.

    Args:
        G: Noise-weighted compliances per prior standard deviation [-].
        W_c: Noise-weighted change of the data per standard deviation of each error that
            is considered, see `ErrorBudget` [-].
    """
    if W_c.shape[1] == 0:
        return G
    C = posterior(G)
    D = C @ G.T @ W_c
    variance, V = np.linalg.eigh(C + D @ D.T)
    variance = np.clip(variance, np.finfo(float).eps, 1.0)  # rounding, or the prior
    return np.sqrt(1.0 / variance - 1.0)[:, None] * V.T


def data_only_std(G: Float[HostArray, "n_e n_p"]) -> Float[HostArray, " n_p"]:
    """Compute standard deviations from the data alone, roots of diag((G^T G)^-1).

    Args:
        G: Noise-weighted compliances per prior standard deviation [-].

    Returns:
        Standard deviations in units of the prior's [-]; infinite for parameters with a
        component in a blind direction.
    """
    std = np.full(G.shape[1], np.inf)
    size = np.linalg.norm(G, axis=0)
    seen = size > VANISHED * np.max(size, initial=0.0)
    if not np.any(seen):
        return std
    _, singular, Vt = np.linalg.svd(G[:, seen] / size[seen])
    known = np.zeros(len(Vt), bool)
    known[: len(singular)] = singular > BLIND * singular[0]
    variance = np.sum((Vt[known].T / singular[known[: len(singular)]]) ** 2, axis=1)
    # Any component above rounding in a blind direction makes a parameter uncertain.
    drifts = np.max(np.abs(Vt[~known]), axis=0, initial=0.0) > BLIND
    std[seen] = np.where(drifts, np.inf, np.sqrt(variance) / size[seen])
    return std


def si_slope(
    space: ParameterSpace, z: Float[Array | HostArray, " n_p"]
) -> Float[HostArray, " n_p"]:
    """Compute dp/dz of each parameter, in its SI unit per unit of z."""
    z = jnp.asarray(z)
    _, slope = jax.jvp(space.from_scaled, (z,), (jnp.ones_like(z),))
    return np.abs(np.asarray(slope))
