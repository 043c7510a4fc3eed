"""Assess what a finished calibration may claim: converged, consistent, identified."""

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from softcal_jax._module import Module, Result
from softcal_jax._names import listed
from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    MultiStartResult,
)
from softcal_jax.identifiability._identify import identifiability
from softcal_jax.identifiability._result import Identifiability
from softcal_jax.inference import ErrorBudget
from softcal_jax.unknowns import MESH


class Prediction(Module):
    """Uncertainty of one predicted pose.

    Attributes:
        name: Name of the configuration.
        role: Whether it was fitted or held out.
        std: Standard error of its markers by those of the parameters: root mean square
            distance [m]; infinite where it depends on parameters that nothing sees.
    """

    name: str
    role: str
    std: float


def _predictions(
    fits: Sequence[ConfigurationResult], report: Identifiability
) -> tuple[Prediction, ...]:
    """Carry the covariance of the parameters into the markers of configurations.

    The rows W_ep of Eq. (9) times the covariance by all causes: how far off a pose
    would be if only the parameters were wrong.
    """
    predictions = []
    for fit in fits:
        if fit.W_ep is None or not fit.points:
            continue
        variance = 0.0
        for marker in fit.points:
            rows = marker.seen[:, None] * fit.W_ep[marker.index] * report.asked
            variance += float(np.sum(report.spread.along(rows) ** 2))
        std = float(np.sqrt(variance / len(fit.points)))
        predictions.append(Prediction(fit.name, fit.role, std))
    return tuple(predictions)


class Assessment(Result):
    """Verdict on a calibration.

    Attributes:
        identified: Whether all parameters may be trusted: the fit and its noise
            converged, its residuals are no larger than the stated noise, every
            configuration is explained, no parameter sits on a bound, no other optimum
            fits as well, tets do not lock, and all are known as well as was asked.
        reasons: Why not, one sentence each; empty if identified.
        misfit_probability: Probability of residuals this large if model and stated
            noise are right; None if the noise was estimated from them [-].
        identifiability: Which parameters and directions the data see.
        predictions: What the uncertainty of the parameters does to each pose.
    """

    identified: bool
    reasons: tuple[str, ...]
    misfit_probability: float | None
    identifiability: Identifiability
    predictions: tuple[Prediction, ...] = ()

    @property
    def prediction(self) -> str:
        """How well poses are predicted, in a sentence; empty without markers."""
        parts = []
        for role, words in (("calibration", "fitted"), ("validation", "held-out")):
            errors = [p.std for p in self.predictions if p.role == role]
            if errors:
                std = float(np.sqrt(np.mean(np.square(errors))))
                off = f"{1e3 * std:.2g} mm" if np.isfinite(std) else "an unknown amount"
                parts.append(f"the {words} poses by {off}")
        if not parts:
            return ""
        return (
            f"The uncertainty of the parameters moves the markers of "
            f"{' and of '.join(parts)} (one standard error)."
        )

    @property
    def headline(self) -> str:
        """The verdict; it ends with a colon where reasons follow."""
        return "Identified." if self.identified else "Not identified:"

    def _words(self) -> str:
        return " ".join([self.headline, *self.reasons])

    def __str__(self) -> str:
        """The verdict and its reasons, then the identifiability report."""
        lines = ["\n  ".join([self.headline, *self.reasons]), str(self.identifiability)]
        return "\n".join([*lines, self.prediction]).rstrip()


def assess(result: CalibrationResult, *, precision: float | None = None) -> Assessment:
    """Assess what a calibration may claim.

    The verdict compares standard errors by all causes with those that are asked for,
    see `identifiability`; how wide bounds are does not matter.

    Model error shows as residuals above a stated noise, by chi-squared; noise that is
    estimated from the residuals hides model error.

    Args:
        result: The calibration.
        precision: Standard error that is asked for, relative to the value; that of the
            calibration by default [-].
    """
    spread = result.uncertainty
    report = identifiability(
        result.linear.with_scale(spread.level),
        result.space,
        result.z,
        precision=result.precision if precision is None else precision,
    )
    reasons = []
    if not result.converged:
        reasons.append("The calibration did not converge.")
    if not result.noise_settled:
        reasons.append(
            "The noise did not settle beside the fit, so neither the weights of the "
            "data nor the standard errors can be trusted."
        )
    if spread.misfits:
        reasons.append(
            "The model cannot match the data within the stated noise: chi-squared "
            f"{spread.chi_squared:.4g} for {spread.degrees_of_freedom} degrees of "
            "freedom. Parameters of a wrong model are not properties of the material: "
            "change the law, the element, the control points or the stated noise."
        )
    if result.left_out:
        reasons.append(
            "The standard errors are those by the noise alone: left out were "
            f"{listed(result.left_out)}."
        )
    reasons += result.checks.reasons if result.checks is not None else ()
    reasons += _contradictions(result)
    reasons += [f"{p.name} ended on a bound." for p in result.parameters if p.at_bound]
    if result.model.mesh.order == 1:
        reasons += _locking(result.budget, report)
    reasons += _wide(report, result)
    reasons += _rivals(result.starts, spread.level)
    for verdict, words in (
        ("not identifiable", "The data do not determine"),
        ("weakly identifiable", "The data determine only weakly"),
    ):
        named = [p.name for p in report.parameters if p.verdict == verdict]
        if named:
            reasons.append(f"{words}: {', '.join(named)}.")
    if report.blind:
        reasons.append(
            f"The data hardly see {len(report.blind)} of {report.n_parameters} "
            "directions of the parameters."
        )
    return Assessment(
        identified=not reasons,
        reasons=tuple(reasons),
        misfit_probability=spread.misfit_probability,
        identifiability=report,
        predictions=_predictions(result.configurations, report),
    )


def _locking(budget: ErrorBudget, report: Identifiability) -> list[str]:
    """Say what linear tets may do to the values, unless that is switched off."""
    errors = budget.by_cause().get(MESH)
    if errors is None:
        return []
    amount = ", by an unknown amount here"
    if np.any(np.isfinite(errors)):  # nan on a bound
        asked = np.array([p.asked for p in report.parameters])
        worst = int(np.nanargmax(errors / asked))
        error = budget.readable(worst, errors[worst])
        amount = f": {budget.names[worst]} may be off by {error} by the mesh alone"
    return [f"Linear tets lock in bending{amount}. Use quadratic tets (to_quadratic)."]


def _wide(report: Identifiability, result: CalibrationResult) -> list[str]:
    """Name parameters that are less certain than the bounds that the user typed."""
    pairs = zip(report.parameters, result.space.parameters, strict=True)
    return [
        f"{p.name} is less certain than its bounds are wide: they say more than the "
        "data."
        for p, bounds in pairs
        if float(bounds.upper - bounds.lower) < p.standard_error < np.inf
    ]


def _contradictions(result: CalibrationResult) -> list[str]:
    """Name the configurations that the calibrated model does not explain."""
    done = {"calibration": "fitted", "validation": "predicted"}
    return [
        f"{fit.name} is {done[fit.role]} with its markers {fit.off}: the model "
        "contradicts it."
        for fit in result.configurations
        if fit.misfit(result.uncertainty.noise, result.uncertainty.level)
    ]


def _rivals(search: MultiStartResult | None, noise_scale: float) -> list[str]:
    """Name other optima that the data hardly exclude, if several starts were tried."""
    if search is None or not search.optima:
        return []
    best, *others = search.optima
    allowed = 0.5 * noise_scale**2 * float(chdtri(1, 0.05))
    return [
        f"Other values fit as well: {other.words} (cost {other.cost:.3g}, the "
        f"best {best.cost:.3g})."
        for other in others
        if other.cost - best.cost <= allowed
    ]
