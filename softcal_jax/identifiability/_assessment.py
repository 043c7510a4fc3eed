"""Assess what a finished calibration may claim: converged, consistent, identified."""

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
from scipy.special import chdtri

from softcal_jax._module import Module, Result
from softcal_jax._text import listed
from softcal_jax._units import readable, readable_values
from softcal_jax.calibration import MISSED, CalibrationResult, ConfigurationResult
from softcal_jax.fields import constants_of
from softcal_jax.identifiability._identify import identifiability
from softcal_jax.identifiability._result import Identifiability, Verdict
from softcal_jax.mesh import thin_share
from softcal_jax.unknowns import MESH

Outcome = Literal["trust", "take with care", "do not use"]

FAR_OUT = 10.0
"""Size of the residuals over the stated errors beyond which values are useless [-]."""

UNDERRATED = 3.6
"""Factor on the estimated error of a mesh with walls of one or two quadratic tets [-].

Under torsion, and where pressure bulges a wall, the estimate can be too small there.
"""

THIN = 0.25
"""Share of the surface with such walls from which they count [-]."""

UNSEEN = 0.9
"""Share of a stated error from which the data say nothing of what is held fixed [-]."""


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
        points = [point for point in fit.points if point.seen.any()]
        if fit.W_ep is None or not points:
            continue
        variance = 0.0
        for marker in points:
            rows = marker.seen[:, None] * fit.W_ep[marker.index] * report.asked
            variance += float(np.sum(report.spread.along(rows) ** 2))
        std = float(np.sqrt(variance / len(points)))
        predictions.append(Prediction(fit.name, fit.role, std))
    return tuple(predictions)


class Assessment(Result):
    """Verdict on a calibration.

    Attributes:
        outcome: "trust" if no check speaks against the values: the fit and its noise
            converged, its residuals are no larger than stated errors, every
            configuration is explained, contact is as modelled, no parameter sits on a
            bound, no other optimum fits as well, tets do not lock, and all are known as
            well as was asked. "do not use" if it did not converge, the data push a
            parameter beyond its bound, or it misses them by far, see `MISSED` and
            `FAR_OUT`. Otherwise "take with care".
        reasons: Why it is no more than that, the most important first: what makes the
            values useless, other values that fit as well, what contradicts the model,
            then the others by how much they may change a value.
        contradicted: Whether the model contradicts the data.
        misfit_probability: Probability of residuals this large if model and stated
            noise are right; None if the noise was estimated from them [-].
        identifiability: Which parameters and directions the data see.
        predictions: What the uncertainty of the parameters does to each pose.
        held: Constants of the material that are not fitted, and that the data would not
            determine either: they leave at least `UNSEEN` of the stated errors.
    """

    outcome: Outcome
    reasons: tuple[str, ...]
    contradicted: bool
    misfit_probability: float | None
    identifiability: Identifiability
    predictions: tuple[Prediction, ...] = ()
    held: tuple[str, ...] = ()

    @property
    def identified(self) -> bool:
        """Whether the values may be trusted."""
        return self.outcome == "trust"

    @property
    def prediction(self) -> str:
        """How well poses are predicted, in a sentence; empty without markers."""
        parts = []
        for role, words in (("calibration", "fitted"), ("validation", "held-out")):
            errors = [p.std for p in self.predictions if p.role == role]
            if errors:
                std = float(np.sqrt(np.mean(np.square(errors))))
                off = (
                    readable(std, "about") if np.isfinite(std) else "an unknown amount"
                )
                parts.append(f"{off} in the {words} poses")
        if not parts:
            return ""
        return (
            "The standard errors of the parameters make the markers uncertain by "
            f"{' and '.join(parts)}."
        )

    @property
    def held_fixed(self) -> str:
        """Which constants are held fixed and not identifiable, in a sentence, or ""."""
        if not self.held:
            return ""
        return (
            f"Held fixed, and not identifiable from these data: {', '.join(self.held)}."
        )

    def seen(self, verdict: Verdict) -> str:
        """Write what the data tell of a parameter, if the model is not contradicted."""
        doubtful = self.contradicted and verdict != "not identifiable"
        return f"{verdict} if the model is right" if doubtful else verdict


def assess(result: CalibrationResult, *, precision: float | None = None) -> Assessment:
    """Assess what a calibration may claim.

    The verdict compares standard errors by all causes with those that are asked for,
    see `identifiability`; how wide bounds are does not matter.

    Model error shows as residuals above stated errors, by chi-squared; noise that is
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
        model=result.model,
        precision=result.precision if precision is None else precision,
    )
    fatal = _fatal(result)
    pushed, ratios = result.pushed, {p.name: p.ratio for p in report.parameters}
    checks = [
        (ratios.get(p.name, np.inf), f"{p.name} ended on a bound.")
        for p in result.parameters
        if p.at_bound and p.name not in pushed
    ]
    wide = "is wider than its bounds, which say more than the data."
    checks += [
        (p.ratio, f"The standard error of {p.name} {wide}")
        for p, bounds in zip(report.parameters, result.space.parameters, strict=True)
        if float(bounds.upper - bounds.lower) < p.standard_error < np.inf
    ]
    checks += [*_too_coarse(result, report), *_unseen(report)]
    checks.sort(key=lambda check: -np.nan_to_num(check[0], nan=np.inf))
    reasons = [*fatal, *_rivals(result), *result.doubts]
    reasons += filter(None, [result.repeated])
    reasons += [*result.contact_doubts, *(reason for _, reason in checks)]
    if result.left_out:
        reasons.append(
            "The standard errors include the noise alone; left out were "
            f"{listed(result.left_out)}."
        )
    useless = fatal or pushed or _size_of_residuals(result) > FAR_OUT
    return Assessment(
        outcome="do not use" if useless else "take with care" if reasons else "trust",
        reasons=tuple(reasons),
        contradicted=result.contradicted,
        misfit_probability=spread.misfit_probability,
        identifiability=report,
        predictions=_predictions(result.configurations, report),
        held=_held(result),
    )


def _held(result: CalibrationResult) -> tuple[str, ...]:
    """Name the constants that are held fixed and that the data say nothing of."""
    linear = result.linear.of_fit()
    constants = {path.rpartition(".")[2] for path, *_ in constants_of(result.model)}
    std = np.sqrt(np.diag(linear.considered_covariance()))
    left = zip(linear.considered.names, std, strict=True)
    return tuple(name for name, share in left if name in constants and share >= UNSEEN)


def _fatal(result: CalibrationResult) -> list[str]:
    """Say why the values must not be used, if so."""
    fatal = []
    if not result.converged:
        fatal.append("The fit did not converge.")
    if not result.noise_settled:
        fatal.append(
            "The estimate of the noise did not settle, so that weights and standard "
            "errors are wrong."
        )
    if result.missed > MISSED:
        share = 100 * result.missed
        fatal.append(f"The held-out error is {share:.0f} % of the motion.")
    return fatal


def _size_of_residuals(result: CalibrationResult) -> float:
    """Return the residuals over the stated errors; nan where none are stated [-]."""
    spread = result.uncertainty
    if spread.noise == "stated" and spread.degrees_of_freedom > 0:
        return float(np.sqrt(spread.chi_squared / spread.degrees_of_freedom))
    return float("nan") if result.checks is None else result.checks.level


Check = tuple[float, str]
"""How much a value may change, over the error that is asked for [-], and why."""


def _unseen(report: Identifiability) -> list[Check]:
    """Name the parameters that the data do not determine as well as was asked."""
    unseen = []
    for verdict, words in (
        ("not identifiable", "The data do not determine"),
        ("weakly identifiable", "The data determine only weakly"),
    ):
        named = {p.name: p.ratio for p in report.parameters if p.verdict == verdict}
        if named:
            unseen.append((max(named.values()), f"{words}: {', '.join(named)}."))
    if report.blind:
        words = (
            f"The data leave {len(report.blind)} of {report.n_parameters} directions "
            "of the parameters undetermined."
        )
        unseen.append((max(direction.ratio for direction in report.blind), words))
    return unseen


def _too_coarse(result: CalibrationResult, report: Identifiability) -> list[Check]:
    """Say what the mesh may do to the values, unless that is switched off.

    Walls of one or two quadratic tets count with `UNDERRATED` times their estimate.
    """
    budget, mesh = result.budget, result.model.mesh
    errors = budget.by_cause().get(MESH)
    if errors is None:
        return []
    asked = np.array([p.asked for p in report.parameters])
    known = np.any(np.isfinite(errors))  # nan on a bound
    worst = int(np.nanargmax(errors / asked)) if known else 0
    change = errors[worst] / asked[worst]
    off = lambda times: (
        f"{budget.names[worst]} may be off by "
        f"{budget.readable(worst, times * errors[worst])} by the mesh alone"
    )
    if mesh.order == 1:
        amount = f": {off(1.0)}" if known else ", by an unknown amount here"
        words = (
            f"Linear tets lock in bending{amount}. Use quadratic tets (to_quadratic)."
        )
        return [(change, words)]
    if not (known and UNDERRATED * change > 1.0):
        return []
    if (thin := thin_share(mesh)) < THIN:
        return []
    words = (
        f"Walls are at most two quadratic tets thick (over {100.0 * thin:.0f} % of the "
        f"surface), where the error of the mesh can be {UNDERRATED:g} times its "
        f"estimate: {off(UNDERRATED)}. Refine it."
    )
    return [(UNDERRATED * change, words)]


def _rivals(result: CalibrationResult) -> Iterator[str]:
    """Name other optima that the data hardly exclude, if several starts were tried."""
    if result.starts is None or not result.starts.optima:
        return
    best, *others = result.starts.optima
    allowed = 0.5 * result.uncertainty.level**2 * float(chdtri(1, 0.05))
    units = {q.name: q.unit for q in result.space.parameters}
    for other in others:
        if other.cost - best.cost <= allowed:
            values = ", ".join(
                f"{name} = {readable_values([value], units[name])}"
                for name, value in other.values.items()
            )
            yield (
                f"Other values fit as well: {values} (cost {other.cost:.3g}, the best "
                f"{best.cost:.3g})."
            )
