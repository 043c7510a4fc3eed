"""Uncertainty of calibrated parameters by the noise."""

from typing import Literal

import equinox as eqx
import numpy as np
from scipy.special import chdtrc, ndtr, stdtr

from softcal_jax._module import Module
from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax.inference._linear_model import LinearModel

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
    linear: LinearModel,
    noise: Literal["stated", "estimated"],
    scale: float | None = None,
) -> Uncertainty:
    """Compute the covariance (W^T V^-1 W + P)^-1 of the parameters not on a bound.

    The scale s of the noise is 1 for a stated one; for an estimated one s^2 is by
    default the sum of squared errors over its degrees of freedom, so that only the
    ratios of the stated standard deviations count (Bates and Watts, Nonlinear
    Regression Analysis, ch. 2). A parameter uses up a degree of freedom only to the
    extent that the data determine it, rather than its prior.

    Args:
        linear: The fit, with a `scale` of 1.
        noise: Where the noise comes from.
        scale: s of an estimated noise where it is known already, see `weighed_fit` [-].
    """
    n = int(linear.fitted.sum())
    dof = linear.n_data - _informed(linear)
    chi_squared = float(np.sum(linear.whitened().error[:n] ** 2))
    if noise == "stated":
        scale = 1.0
    elif scale is None:
        scale = float(np.sqrt(chi_squared / dof)) if dof > 0 else np.nan
    covariance = np.full((len(linear.held),) * 2, np.nan)
    if np.isfinite(scale):
        covariance = linear.with_scale(scale).covariance()
    return Uncertainty(covariance, noise, scale, dof, chi_squared, linear.held)


def _informed(linear: LinearModel) -> int:
    """Count the parameters that the data determine rather than the prior, rounded."""
    if not np.any(linear.prior_weights):
        return int(np.sum(~linear.held))
    n = int(linear.fitted.sum())
    return round(float(np.sum(linear.solution.basis[:n] ** 2)))
