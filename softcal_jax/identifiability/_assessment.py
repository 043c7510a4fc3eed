"""Assess what a finished calibration may claim: converged, consistent, identified."""

import math

import equinox as eqx
from scipy.special import chdtri

from softcal_jax.calibration import EXACT, CalibrationResult, MultiStartResult
from softcal_jax.identifiability._identify import identifiability
from softcal_jax.identifiability._result import Identifiability


class Assessment(eqx.Module):
    """Verdict on a calibration.

    Attributes:
        identified: Whether all parameters may be trusted: the fit converged, its
            residuals are no larger than the stated noise, every configuration, held
            out or not, is explained, no parameter sits on a bound, no other optimum
            fits as well, and the data see every direction.
        reasons: Why not, one sentence each; empty if identified.
        misfit_probability: Probability of residuals this large if model and stated
            noise are right; None if the noise was estimated from them [-].
        identifiability: Which parameters and directions the data see.
    """

    identified: bool
    reasons: tuple[str, ...]
    misfit_probability: float | None
    identifiability: Identifiability

    def __str__(self) -> str:
        """The verdict and its reasons, then the identifiability report."""
        head = "Identified." if self.identified else "Not identified:"
        return "\n  ".join([head, *self.reasons]) + f"\n{self.identifiability}"


def assess(result: CalibrationResult) -> Assessment:
    """Assess what a calibration may claim.

    Model error shows as residuals above the noise: with stated noise and a correct
    model, the sum of squared errors in noise units follows a chi-squared distribution
    whose degrees of freedom are measured coordinates minus parameters. Noise that is
    estimated from the residuals hides model error.
    """
    spread = result.uncertainty
    # Data simulated with the model itself leave no noise to estimate.
    known = math.isfinite(spread.noise_scale) and spread.noise_scale > EXACT
    report = identifiability(
        result.W_ep,
        result.space,
        result.z,
        noise_scale=spread.noise_scale if known else 1.0,
        W_c=result.budget.W_c,
    )
    reasons = []
    if not result.converged:
        reasons.append("The calibration did not converge.")
    if spread.misfits:
        reasons.append(
            "The model cannot match the data within the stated noise: chi-squared "
            f"{spread.chi_squared:.4g} for {spread.degrees_of_freedom} degrees of "
            "freedom. Parameters of a wrong model are not properties of the material: "
            "change the law, the element, the control points or the stated noise."
        )
    reasons += result.checks.reasons if result.checks is not None else ()
    reasons += _contradictions(result)
    reasons += [f"{p.name} ended on a bound." for p in result.parameters if p.at_bound]
    reasons += _rivals(result.starts, spread.noise_scale if known else 1.0)
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
    elif report.verdict != "identifiable":
        reasons.append("The data determine some combinations only weakly.")
    return Assessment(not reasons, tuple(reasons), spread.misfit_probability, report)


def _contradictions(result: CalibrationResult) -> list[str]:
    """Name the configurations that the calibrated model does not explain."""
    done = {"calibration": "fitted", "validation": "predicted"}
    return [
        f"{fit.name} is {done[fit.role]} with its markers {fit.off}: the model "
        "contradicts it."
        for fit in result.configurations
        if fit.misfit(result.uncertainty.noise) is not None
    ]


def _rivals(found: MultiStartResult | None, noise_scale: float) -> list[str]:
    """Name other optima that the data hardly exclude, if several starts were tried."""
    if found is None or not found.optima:
        return []
    best, *others = found.optima
    allowed = 0.5 * noise_scale**2 * float(chdtri(1, 0.05))
    reasons = []
    for other in others:
        if other.cost - best.cost <= allowed:
            values = ", ".join(f"{k} {v:.4g}" for k, v in other.values.items())
            reasons.append(
                f"Other values fit as well: {values} (cost {other.cost:.3g}, the best "
                f"{best.cost:.3g})."
            )
    return reasons
