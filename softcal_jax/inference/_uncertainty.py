"""Uncertainty of parameters: by the noise, by all causes, and between two robots.

What is held fixed is a consider parameter c, with a standard deviation and no estimate
(Schmidt, Adv. Control Systems 3, 1966; Tapley, Schutz, Born, Statistical Orbit
Determination, 2004, ch. 6): an error dc moves the optimum by dz = -G W_c dc, with the
gain G of `LinearModel`, and the covariance of the estimate is that of the noise plus
the sum of G W_c W_c^T G^T over the causes. Offsets of recordings and creep belong to
the noise; they are causes too, by the same gain, and what is left of the noise is its
jitter.

Do two robots give the same values? With the posterior of one as the prior of the other,
a prior contradicts the data or does not: the difference d of both estimates against its
covariance, by d^T (C_A + C_B)^-1 d (chi-squared; Evans and Moshonov, Bayesian Anal. 1,
2006, on conflicts of prior and data). Errors that both share, like that of the same nu,
count in both covariances, which makes the check more lenient.
"""

from dataclasses import fields
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.special import chdtrc, ndtr, stdtr

from softcal_jax._module import Module
from softcal_jax._text import listed
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax._units import readable_unit, readable_values
from softcal_jax.fields import KINDS, ParameterSpace, Uncertain
from softcal_jax.inference._least_squares import RANK
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

    def _errors(self, name: str) -> tuple[int, float, dict[str, float]]:
        """Return the index of a parameter, its standard error, and that by cause."""
        i = self.names.index(name)
        by_cause = {cause: float(std[i]) for cause, std in self.by_cause().items()}
        return i, float(self.standard_errors[i]), by_cause

    def sentence(self, name: str) -> str:
        """Say how uncertain a parameter is and why, like "noise 4 %, nu 31 %"."""
        i, total, errors = self._errors(name)
        if not np.isfinite(total):
            return "no standard error"
        shown = [c for c in errors if c == NOISE or errors[c] >= SMALL * total]
        shown.sort(key=lambda c: (c != NOISE, -errors[c]))
        parts = [f"{cause} {self.readable(i, errors[cause])}" for cause in shown]
        return ", ".join(parts)

    def advice(self, name: str) -> str:
        """Say what would lower the error of a parameter most, and to what."""
        i, total, errors = self._errors(name)
        if not np.isfinite(total):
            return f"measure more: {name} has no standard error."
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
    if unit in ("rad", "m", "N") or value == 0.0:
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


class Estimate(NamedTuple):
    """Parameters, z and its covariance, and whether the data contradict the model."""

    space: ParameterSpace
    z: Float[Array | HostArray, " n_p"]
    covariance: Float[HostArray, "n_p n_p"]
    contradicted: bool = False


class Difference(Module):
    """What robot A gave for the material beside what robot B gave, in SI.

    Attributes:
        names: The parameters of the material that both have estimated.
        units: Their units.
        of_a: Values from A.
        of_b: Values from B.
        std_a: Their standard errors from A, by all causes.
        std_b: Those from B.
        chi_squared: Of all differences together [-].
        directions: Number of independent differences: fewer than parameters where some
            of these vary together without a rest.
        worst: Change from A to B along the direction in which they differ most.
        worst_size: Its size in standard errors [-].
        contradicted: Robots of which the model contradicts the data: "A", "B".
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    of_a: Float[HostArray, " n"]
    of_b: Float[HostArray, " n"]
    std_a: Float[HostArray, " n"]
    std_b: Float[HostArray, " n"]
    chi_squared: float
    directions: int
    worst: Float[HostArray, " n"]
    worst_size: float
    contradicted: tuple[str, ...]

    @property
    def unseen(self) -> Float[HostArray, " n"]:
        """Differences that would hardly be seen: two standard errors."""
        return 2.0 * np.hypot(self.std_a, self.std_b)

    @property
    def probability(self) -> float:
        """Probability of differences as large, if both are of one material [-]."""
        return float(chdtrc(self.directions, self.chi_squared))

    @property
    def agree(self) -> bool:
        """Whether both agree within their errors, and each with its own data."""
        return self.probability >= UNLIKELY and not self.contradicted


def difference(a: Estimate, b: Estimate) -> Difference:
    """Compare what two robots give for the parameters of the material, by their names.

    Parameters of the setup belong to one experiment each, whatever their names.

    Raises:
        ValueError: If no parameter of the material has a standard error in both.
    """
    rows = [_known(estimate) for estimate in (a, b)]
    names = [name for name in rows[1] if name in rows[0]]
    if not names:
        raise ValueError(
            "no parameter of the material has a standard error in both: A has "
            f"{listed(a.space.names)}, and B has {listed(b.space.names)}. Calibrate "
            "the same law, with parameters of the same names."
        )
    of_a, of_b = ([row[name] for name in names] for row in rows)
    value_a, value_b = (e.space.from_scaled(jnp.asarray(e.z)) for e in (a, b))
    z = b.space.to_scaled(value_b.at[np.array(of_b)].set(value_a[np.array(of_a)]))
    d = np.asarray(b.space.shorter(jnp.asarray(b.z) - z))[of_b]
    slopes = b.space.slopes(z)[of_b]
    unit = a.space.slopes(a.z)[of_a] / slopes
    C_a = a.covariance[np.ix_(of_a, of_a)] * np.outer(unit, unit)
    C_b = b.covariance[np.ix_(of_b, of_b)]
    apart = np.sqrt(np.diag(C_a + C_b))  # each alone
    size, Q = np.linalg.eigh((C_a + C_b) / np.outer(apart, apart))
    size, Q = size[size > RANK**2 * size[-1]], Q[:, size > RANK**2 * size[-1]]
    along = Q.T @ (d / apart)
    most = int(np.argmax(np.abs(along) / np.sqrt(size)))
    std = lambda e: e.space.slopes(e.z) * np.sqrt(np.diag(e.covariance))
    return Difference(
        names=tuple(names),
        units=tuple(b.space.parameters[i].unit for i in of_b),
        of_a=np.asarray(value_a)[of_a],
        of_b=np.asarray(value_b)[of_b],
        std_a=std(a)[of_a],
        std_b=std(b)[of_b],
        chi_squared=float(np.sum(along**2 / size)),
        directions=len(size),
        worst=slopes * apart * Q[:, most] * along[most],
        worst_size=float(abs(along[most]) / np.sqrt(size[most])),
        contradicted=tuple(name for name, e in (("A", a), ("B", b)) if e.contradicted),
    )


def _known(estimate: Estimate) -> dict[str, int]:
    """Index the parameters of the material that have a standard error, by name."""
    space = estimate.space
    known = np.isfinite(np.diag(estimate.covariance)) & np.array(space.sets_fields)
    return {space.names[i]: i for i in np.flatnonzero(known).tolist()}
