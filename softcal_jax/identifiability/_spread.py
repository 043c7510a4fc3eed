"""Spread of the parameters given noise and bounds, and what to call it."""

from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.fields import ParameterSpace

Verdict = Literal["identifiable", "weakly identifiable", "not identifiable"]

IDENTIFIABLE_BELOW = 0.1
"""Spread below which a parameter is identifiable [-].

The spread is the predicted standard deviation over that of the bounds. At 0.1 the data
know a hundred times (99 %) more than the bounds, and the standard deviation is 2.9 % of
the range.
"""

WEAK_BELOW = 0.5
"""Spread above which a parameter is not identifiable [-].

At 0.5 three quarters of the information come from the data; above it the bounds that
the user typed decide too much of the value.
"""

BLIND = 1e-6
"""Singular value, over the largest, below which a direction is rounding only [-].

Columns have unit length then, as in `calibration.uncertainty`.
"""

VANISHED = 1e-12
"""Sensitivity, over the largest, below which a parameter moves nothing [-]."""


def verdict(spread: float) -> Verdict:
    """The word for a spread: predicted over prior standard deviation [-]."""
    if spread < IDENTIFIABLE_BELOW:
        return "identifiable"
    return "weakly identifiable" if spread <= WEAK_BELOW else "not identifiable"


def prior_std(space: ParameterSpace) -> Float[HostArray, " n_p"]:
    """Standard deviation of what is known before any data, scaled [-].

    That of a uniform density between the bounds, or the `prior_std` of a parameter
    where it is smaller.
    """
    bounds = np.asarray(space.upper() - space.lower()) / np.sqrt(12.0)
    weights = np.asarray(space.prior_weights())
    return 1.0 / np.maximum(1.0 / bounds, weights)


def posterior(G: Float[HostArray, "n_e n_p"]) -> Float[HostArray, "n_p n_p"]:
    """Covariance (I + G^T G)^-1 in units of the prior's standard deviations.

    Linear-Gaussian Bayes (Tarantola, Inverse Problem Theory, 2005, ch. 3): Fisher
    information of the data plus that of the prior. It exists whatever the data lack.

    Args:
        G: Noise-weighted compliances per prior standard deviation: signal to noise.

    Returns:
        The covariance [-]; a blind direction keeps a variance of one.
    """
    _, singular, Vt = np.linalg.svd(G)
    variance = np.ones(G.shape[1])
    variance[: len(singular)] = np.hypot(1.0, singular) ** -2.0
    return (Vt.T * variance) @ Vt


def data_only_std(G: Float[HostArray, "n_e n_p"]) -> Float[HostArray, " n_p"]:
    """Standard deviations from the data alone, roots of diag((G^T G)^-1).

    Args:
        G: Noise-weighted compliances per prior standard deviation [-].

    Returns:
        Standard deviations in units of the prior's [-]; infinite for each parameter
        that takes part in a blind direction.
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
    # A component of BLIND is as uncertain as the direction itself.
    drifts = np.max(np.abs(Vt[~known]), axis=0, initial=0.0) > BLIND
    std[seen] = np.where(drifts, np.inf, np.sqrt(variance) / size[seen])
    return std


def si_slope(
    space: ParameterSpace, z: Float[Array | HostArray, " n_p"]
) -> Float[HostArray, " n_p"]:
    """dp/dz of each parameter, which is scaled by itself: SI unit per unit of z."""
    z = jnp.asarray(z)
    _, slope = jax.jvp(space.from_scaled, (z,), (jnp.ones_like(z),))
    return np.abs(np.asarray(slope))
