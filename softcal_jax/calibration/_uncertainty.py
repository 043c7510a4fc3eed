"""Uncertainty of calibrated parameters from the noise and the compliances."""

from typing import Literal

import equinox as eqx
import numpy as np
from scipy.special import chdtrc, ndtr, stdtr

from softcal_jax._module import Module
from softcal_jax._typing import Bool, Float, HostArray

BLIND = 1e-6
"""Singular value, over the largest, below which a direction is only rounding [-]."""

UNLIKELY = 0.01
"""Probability of a chi-squared as large by chance, below which the fit misfits."""

EXACT = 1e-3
"""Ratio of residuals to noise below which the residuals are no sample of it [-]."""


class Uncertainty(Module):
    """Covariance of the parameters, to first order.

    Attributes:
        covariance: Covariance of the scaled parameters by the noise, offsets of
            recordings included [-]; nan for those on a bound or not determined by the
            data. Parameters on a bound count as known, so that of the others is
            conditional on them.
        noise: "stated" by the user, or "estimated" from the residuals.
        noise_scale: Factor on the stated standard deviations; 1 for a stated noise [-].
        degrees_of_freedom: Measured coordinates minus free parameters.
        chi_squared: Sum of squared errors in units of the noise, with coordinates that
            vary as stated: that of the whole covariance for a stated noise [-].
        at_bound: Parameters that ended on a bound.
    """

    covariance: Float[HostArray, "n_p n_p"]
    noise: Literal["stated", "estimated"] = eqx.field(static=True)
    noise_scale: float
    degrees_of_freedom: int
    chi_squared: float
    at_bound: Bool[HostArray, " n_p"]

    @property
    def has_noise(self) -> bool:
        """Whether the residuals are a sample of noise, not of data without any."""
        return bool(np.isfinite(self.noise_scale) and self.noise_scale > EXACT)

    @property
    def level(self) -> float:
        """Factor on the stated standard deviations [-].

        1 where data that were made by the model itself left no noise to estimate.
        """
        return self.noise_scale if self.has_noise else 1.0

    @property
    def misfit_probability(self) -> float | None:
        """Probability of residuals as large by chance, if the model is right [-].

        From the chi-squared distribution; None where the noise was estimated from the
        residuals, or there are no degrees of freedom.
        """
        if self.noise == "estimated" or self.degrees_of_freedom <= 0:
            return None
        return float(chdtrc(self.degrees_of_freedom, self.chi_squared))

    @property
    def misfits(self) -> bool:
        """Whether the residuals are larger than the stated noise explains."""
        probability = self.misfit_probability
        return probability is not None and probability < UNLIKELY

    def chance(self, apart: float) -> float:
        """Return the probability of a difference as large, in standard errors [-].

        By the normal distribution for a stated noise, and Student's t for an estimated
        one.
        """
        if self.noise == "stated":
            return float(2.0 * ndtr(-abs(apart)))
        return float(2.0 * stdtr(self.degrees_of_freedom, -abs(apart)))

    @property
    def correlation(self) -> Float[HostArray, "n_p n_p"]:
        """Correlation of the parameters [-]."""
        std = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(std, std)


def uncertainty(
    W: Float[HostArray, "n_e n_p"],
    error: Float[HostArray, " n_e"],
    n_measured: int,
    at_bound: Bool[HostArray, " n_p"],
    noise: Literal["stated", "estimated"],
    prior_weights: Float[HostArray, " n_p"] | None = None,
    scale: float | None = None,
) -> Uncertainty:
    """Compute the covariance (W^T W / s^2 + P)^-1 of the parameters not on a bound.

    s is 1 for a stated noise; for an estimated one s^2 is by default the sum of squared
    errors over its degrees of freedom, so that only the ratios of the stated standard
    deviations count (Bates and Watts, Nonlinear Regression Analysis, ch. 2). P is the
    inverse covariance of the prior. A parameter uses up a degree of freedom only to the
    extent that the data determine it, rather than its prior.

    Args:
        W: Stacked compliances in noise units.
        error: Stacked errors in noise units.
        n_measured: Measured coordinates.
        at_bound: Parameters on a bound; they have no standard error.
        noise: Where the noise comes from.
        prior_weights: 1 / standard deviations of the prior, 0 without; none by default.
        scale: s of an estimated noise where it is known already, see `weighed_fit` [-].
    """
    free = np.flatnonzero(~at_bound)
    weights = np.zeros(W.shape[1]) if prior_weights is None else prior_weights
    prior = np.diag(weights[free])
    dof = n_measured - _informed(W[:, free], prior)
    chi_squared = float(np.sum(error**2))
    covariance = np.full((W.shape[1], W.shape[1]), np.nan)
    if noise == "stated":
        scale = 1.0
    elif scale is None:
        scale = float(np.sqrt(chi_squared / dof)) if dof > 0 else np.nan
    if len(free) and np.isfinite(scale):
        inverse, known = _inverse(np.concatenate([W[:, free], scale * prior]))
        at = free[known]
        covariance[np.ix_(at, at)] = scale**2 * inverse[np.ix_(known, known)]
    return Uncertainty(covariance, noise, scale, dof, chi_squared, at_bound)


def estimator(
    W: Float[HostArray, "n_e n_p"],
    spread: Uncertainty,
    prior_weights: Float[HostArray, " n_p"],
) -> Float[HostArray, "n_p n_e"]:
    """Compute G = (W^T W / s^2 + P)^-1 W^T / s^2: how the fit follows its errors.

    Args:
        W: Stacked compliances in noise units.
        spread: The uncertainty of the fit.
        prior_weights: 1 / standard deviations of the prior, 0 without.

    Returns:
        Change of the scaled parameters per unit of each measured value [-]; nan for
        those that have no standard error.
    """
    free = np.flatnonzero(~spread.at_bound)
    gain = np.full(W.T.shape, np.nan)
    if len(free):
        scale = spread.noise_scale if np.isfinite(spread.noise_scale) else 1.0
        prior = scale * np.diag(prior_weights[free])
        inverse, known = _inverse(np.concatenate([W[:, free], prior]))
        gain[free[known]] = inverse[known] @ W[:, free].T
    return gain


def _informed(
    W: Float[HostArray, "n_e n_free"], prior: Float[HostArray, "n_free n_free"]
) -> int:
    """Count the parameters that the data determine rather than the prior, rounded."""
    if not np.any(prior):
        return W.shape[1]
    normal = W.T @ W
    total = normal + prior.T @ prior
    return round(float(np.trace(np.linalg.pinv(total) @ normal)))


def _inverse(rows: Float[HostArray, "n n_free"]):
    """Return (rows^T rows)^-1, and the indices of parameters for which it is known."""
    # Columns of unit length, so that the scale of a parameter does not make it blind.
    size = np.linalg.norm(rows, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    _, singular, Vt = np.linalg.svd(rows / size)
    singular = np.append(singular, np.zeros(rows.shape[1] - len(singular)))
    seen = singular > BLIND * max(singular[0], 1e-300)
    # A parameter is determined if no direction without data contains it.
    known = np.sum(Vt[~seen] ** 2, axis=0) <= BLIND
    inverse = Vt[seen].T @ np.diag(singular[seen] ** -2.0) @ Vt[seen]
    return inverse / np.outer(size, size), np.flatnonzero(known)
