"""Uncertainty of calibrated parameters: by the noise, and the budget of all causes.

What is held fixed is a consider parameter c, with a standard deviation and no estimate
(Schmidt, Adv. Control Systems 3, 1966; Tapley, Schutz, Born, Statistical Orbit
Determination, 2004, ch. 6): an error dc moves the optimum by dz = -G W_c dc, with the
gain G of `LinearModel`, and the covariance of the estimate is that of the noise plus
the sum of G W_c W_c^T G^T over the causes. Offsets of recordings and creep belong to
the noise; they are causes too, by the same gain, and what is left of the noise is its
jitter.
"""

from dataclasses import fields
from typing import Literal

import equinox as eqx
import numpy as np
from scipy.special import chdtrc, ndtr, stdtr

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax._units import readable_unit, readable_values
from softcal_jax.fields import KINDS, ParameterSpace, Uncertain
from softcal_jax.inference._linear_model import NOISE, LinearModel

UNLIKELY = 0.01
"""Probability of a chi-squared as large by chance, below which the fit misfits."""

EXACT = 1e-3
"""Ratio of residuals to noise below which the residuals are no sample of it [-]."""

REMEDIES = {
    NOISE: "measure each pose four times, or with half the noise",
    "locking": "use quadratic tets",
    "refinement": "take a finer mesh",
    **{field.name: field.metadata["remedy"] for field in fields(Uncertain)},
}
"""What helps against a cause; that of the mesh is named by its error."""

ANY_ANGLE = np.pi / np.sqrt(12.0)
"""Standard deviation of an axis of which nothing is known: 52 degrees [rad]."""

BLIND_FROM = 3.0
"""Standard error over the value that is no knowledge of it [-]."""

BETTER = 0.1, 0.5  # by how much a cause may be better known, at most and at least [-]

SMALL = 0.1  # share of the standard error below which a sentence leaves a cause out [-]


class Uncertainty(Module):
    """Covariance of the parameters, to first order.

    Attributes:
        covariance: Covariance of the scaled parameters by the noise, offsets of
            recordings included [-]; nan for those on a bound or not determined by the
            data. Parameters on a bound count as known, so that of the others is
            conditional on them.
        noise: "stated" by the user, or "estimated" from the residuals.
        noise_scale: Factor on the stated standard deviations; 1 for a stated noise [-].
        degrees_of_freedom: Measured coordinates (and priors) minus free parameters.
        chi_squared: Sum of squared errors in units of the noise, with coordinates that
            vary as stated; for a stated noise that of all stated errors [-].
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
        """Whether the residuals are larger than the stated errors explain."""
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
        scale: s of an estimated noise where it is known already [-].
    """
    if noise == "stated":
        scale, (chi_squared, dof) = 1.0, linear.of_fit().chi_squared()
    else:
        n = int(linear.fitted.sum())
        informed = int(np.sum(~linear.held))
        if np.any(linear.prior_weights):
            informed = round(float(np.sum(linear.solution.basis[:n] ** 2)))
        dof = linear.n_data - informed
        chi_squared = float(np.sum(linear.whitened().error[:n] ** 2))
        if scale is None:
            scale = float(np.sqrt(chi_squared / dof)) if dof > 0 else np.nan
    covariance = np.full((len(linear.held),) * 2, np.nan)
    if np.isfinite(scale):
        covariance = linear.with_scale(scale).covariance()
    return Uncertainty(covariance, noise, scale, dof, chi_squared, linear.held)


class Cause(Module):
    """One reason why the parameters may be wrong.

    Attributes:
        name: Its name, like "nu".
        errors: Names of its errors, like "recording_offset x in left".
        deviations: Change of the scaled parameters per standard deviation of each of
            its errors [-]; nan for parameters that have no standard error.
        std: Stated standard deviation of each of its errors, in its unit.
        unit: SI unit of that, "%" where it is relative; empty where it has none.
        fitted: What would calibrate it along, like "gravity_tilt"; empty if nothing.
    """

    name: str
    errors: tuple[str, ...]
    deviations: Float[HostArray, "n_p n_errors"]
    std: float = float("nan")
    unit: str = ""
    fitted: str = ""

    @property
    def variance(self) -> Float[HostArray, " n_p"]:
        """Variance of the scaled parameters by this cause [-]."""
        return np.sum(self.deviations**2, axis=1)


class ErrorBudget(Module):
    """Standard errors of calibrated parameters, split by cause.

    Attributes:
        names: Names of the parameters.
        values: Their values, in SI.
        slopes: Their change per scaled unit, in SI.
        units: Their SI units.
        noise: Covariance of the scaled parameters by the jitter of coordinates, and
            what the priors leave [-].
        causes: What else may be wrong, the largest first.
    """

    names: tuple[str, ...]
    values: Float[HostArray, " n_p"]
    slopes: Float[HostArray, " n_p"]
    units: tuple[str, ...]
    noise: Float[HostArray, "n_p n_p"]
    causes: tuple[Cause, ...]

    @property
    def covariance(self) -> Float[HostArray, "n_p n_p"]:
        """Covariance of the scaled parameters by all causes together [-]."""
        parts = [cause.deviations @ cause.deviations.T for cause in self.causes]
        return sum(parts, self.noise)

    @property
    def standard_errors(self) -> Float[HostArray, " n_p"]:
        """Standard errors by all causes together, in SI."""
        return self.slopes * np.sqrt(np.diag(self.covariance))

    def by_cause(self) -> dict[str, Float[HostArray, " n_p"]]:
        """Return standard errors by each cause alone in SI, that of the noise first."""
        variances = {NOISE: np.diag(self.noise)}
        variances |= {cause.name: cause.variance for cause in self.causes}
        return {name: self.slopes * np.sqrt(v) for name, v in variances.items()}

    def sentence(self, name: str) -> str:
        """Say how uncertain a parameter is and why, like "noise 4 %, nu 31 %"."""
        i = self.names.index(name)
        total = self.standard_errors[i]
        if not np.isfinite(total):
            return "no standard error"
        errors = {cause: float(std[i]) for cause, std in self.by_cause().items()}
        shown = [c for c in errors if c == NOISE or errors[c] >= SMALL * total]
        shown.sort(key=lambda c: (c != NOISE, -errors[c]))
        parts = [f"{cause} {self.readable(i, errors[cause])}" for cause in shown]
        return ", ".join(parts)

    def advice(self, name: str) -> str:
        """Say what would lower the error of a parameter most, and to what."""
        i = self.names.index(name)
        total = float(self.standard_errors[i])
        if not np.isfinite(total):
            return f"measure more: {name} has no standard error."
        errors = {cause: float(std[i]) for cause, std in self.by_cause().items()}
        worst = max(errors, key=errors.__getitem__)
        exact = Cause(worst, (worst,), np.zeros((0, 0)))
        cause = next((cause for cause in self.causes if cause.name == worst), exact)
        keys = cause.errors[0], worst
        remedy = next(filter(None, map(REMEDIES.get, keys)), f"measure {worst} better")
        rest = float(np.sqrt(max(total**2 - errors[worst] ** 2, 0.0)))
        share = BETTER[1]
        if cause.unit:
            share = np.clip(0.5 * rest / max(errors[worst], 1e-300), *BETTER)
            std = f"{100.0 * share * cause.std:.1g} %"
            if cause.unit != "%":
                std = readable_values([share * cause.std], cause.unit, digits=1)
            along = f", or calibrate {cause.fitted} along" if cause.fitted else ""
            remedy += f" to {std}{along}"
        after = float(np.hypot(rest, share * errors[worst]))
        now, by, bring = (self.readable(i, e) for e in (total, errors[worst], after))
        return (
            f"{remedy}. {name} is uncertain by {now}, by {by} through {worst} alone; "
            f"this would bring {bring}."
        )

    def readable(self, i: int, std: float) -> str:
        """Write an error, given in SI, see `readable_error`."""
        return readable_error(std, float(self.values[i]), self.units[i])

    def __str__(self) -> str:
        """Write one line for each parameter."""
        return "\n".join(f"{name}: {self.sentence(name)}" for name in self.names)


def readable_error(std: float, value: float, unit: str) -> str:
    """Write a standard error in SI: in percent, but for angles and offsets."""
    if np.isnan(std):
        return "an unknown amount"
    if np.isinf(std) or (unit == "rad" and std > ANY_ANGLE):
        return "blind"
    if unit in ("rad", "m") or value == 0.0:
        factor, shown = readable_unit([std], unit)
        return f"{factor * std:.2g} {shown}".rstrip()
    percent = 100.0 * std / abs(value)
    if percent > 100.0 * BLIND_FROM:
        return "blind"
    return f"{percent:.0f} %" if percent >= 100.0 else f"{percent:.2g} %"


def error_budget(
    linear: LinearModel,
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    *,
    noise_is_known: bool,
    uncertain: Uncertain | None = None,
) -> ErrorBudget:
    """Split the uncertainty of a fit by cause.

    Args:
        linear: The fit.
        space: Its parameters.
        z: Where it ended, scaled [-].
        noise_is_known: Whether the level of the noise is known; with too few residuals
            to estimate it, the errors by noise are nan.
        uncertain: How well is known what is not calibrated.
    """
    deviations = linear.deviations()
    del deviations[NOISE]
    noise = (
        linear.covariance(NOISE) if noise_is_known else np.full((len(z),) * 2, np.nan)
    )
    parts = (linear.correlated, linear.considered)
    errors = [e for part in parts for e in zip(part.causes, part.names, strict=True)]
    units = {key.name: key.metadata["unit"] for key in fields(Uncertain)}
    fitted = {k.uncertain: k.name for k in reversed(KINDS.values()) if k.words}
    causes = []
    for name, moved in deviations.items():
        of_cause = tuple(error for cause, error in errors if cause == name)
        std = getattr(uncertain, name, None)
        stated = (std, units[name]) if isinstance(std, int | float) else (np.nan, "")
        causes.append(Cause(name, of_cause, moved, *stated, fitted.get(name, "")))
    whole = np.nan_to_num(sum(cause.variance for cause in causes))
    size = lambda cause: np.nansum(cause.variance / np.where(whole > 0.0, whole, 1.0))
    return ErrorBudget(
        names=tuple(space.names),
        values=np.asarray(space.from_scaled(z)),
        slopes=space.slopes(z),
        units=tuple(q.unit for q in space.parameters),
        noise=noise,
        causes=tuple(sorted(causes, key=size, reverse=True)),
    )
