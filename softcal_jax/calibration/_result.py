"""What a calibration returns."""

import math
from typing import Literal

import numpy as np

from softcal_jax._files import ProjectSource
from softcal_jax._module import Module, Result
from softcal_jax._text import MOST_NAMED, check_known, listed
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax._units import readable_estimate, readable_unit
from softcal_jax.calibration._checkpoint import HistoryEntry
from softcal_jax.calibration._configuration_result import (
    ConfigurationResult,
    off_by,
    omitted,
)
from softcal_jax.calibration._notes import ResidualChecks, contact_doubts
from softcal_jax.calibration._problem import CalibrationSettings
from softcal_jax.calibration._runs import best_of
from softcal_jax.configurations import rms_distance
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import PRECISION, ParameterSpace
from softcal_jax.inference import (
    ANY_ANGLE,
    UNLIKELY,
    ErrorBudget,
    Estimate,
    LinearModel,
    Uncertainty,
    chance,
)
from softcal_jax.unknowns import CorrelatedNoise

SKEWED = 1.8
"""Ratio of the halves of an interval from which on no value +- error is shown [-].

It is that of a modulus known to 30 %, whose interval is symmetric in its logarithm.
"""

MISSED = 0.5
"""Error of the held-out poses over their motion beyond which values are useless [-]."""

IntervalEnd = Literal["likelihood", "bound", "not found"]
IntervalKind = Literal["first-order", "profile", "one-sided", "none"]


class ParameterInterval(Module):
    """Confidence interval of a calibrated parameter, in SI units.

    Attributes:
        name: Its name.
        level: Confidence [-].
        lower: Lower end; nan if it was not found.
        upper: Upper end, likewise. That of a periodic angle may lie beyond its bounds.
        lower_end: What ends it below: "likelihood"; "bound", if the data do not exclude
            the bound of the parameter (or half a turn of a periodic angle); or "not
            found", if fits along the profile did not converge, or were not tried.
        upper_end: The same above.
        unit: SI unit.
        kind: How it was found: "first-order", from a standard error that the cost
            confirms; "profile", from the likelihood itself; "one-sided", likewise, with
            a limit on one side and a bound on the other; or "none".
        why: Why there is no interval; empty if there is one.
    """

    name: str
    level: float
    lower: float
    upper: float
    lower_end: IntervalEnd
    upper_end: IntervalEnd
    unit: str
    kind: IntervalKind = "profile"
    why: str = ""

    def __str__(self) -> str:
        """Write its ends in a readable unit, or why there are none, in one line."""
        turn = self.unit == "rad" and np.isclose(self.upper - self.lower, np.pi)
        if turn and self.lower_end == self.upper_end == "bound":
            return "any angle"
        if self.kind == "none":
            return self.why
        factor, unit = readable_unit([self.lower, self.upper], self.unit)
        both = (self.lower, self.lower_end), (self.upper, self.upper_end)
        words = {"bound": " (bound)"}
        ends = [f"{factor * value:.4g}{words.get(end, '')}" for value, end in both]
        return f"{ends[0]} to {ends[1]} {unit}".rstrip()


class ParameterEstimate(Module):
    """A calibrated parameter, in SI units.

    Attributes:
        name: Its name.
        value: Its value.
        standard_error: Standard error by all causes, see `ErrorBudget`: the one to
            publish. nan on a bound, or if not determined.
        start: Value at the start.
        lower: Lower bound.
        upper: Upper bound.
        unit: SI unit.
        at_bound: Whether it ended on a bound.
        interval: Its confidence interval; None if none was asked for.
        given: Parameters on a bound: the standard error holds with these kept there.
    """

    name: str
    value: float
    standard_error: float
    start: float
    lower: float
    upper: float
    unit: str
    at_bound: bool
    interval: ParameterInterval | None = None
    given: tuple[str, ...] = ()

    @property
    def is_symmetric(self) -> bool:
        """Whether value +- standard error may be shown: no check speaks against it."""
        any_angle = self.unit == "rad" and self.standard_error > ANY_ANGLE
        if any_angle or not math.isfinite(self.standard_error):
            return False
        interval = self.interval
        if interval is None:
            return True
        up, down = interval.upper - self.value, self.value - interval.lower
        return interval.kind == "first-order" and max(up, down) < SKEWED * min(up, down)

    @property
    def estimate(self) -> str:
        """Its value like "263.8 ± 5.9 kPa", or without ± where that does not hold."""
        error = self.standard_error if self.is_symmetric else math.nan
        return readable_estimate(self.value, error, self.unit)

    def __str__(self) -> str:
        """Write its value, its interval if no error is shown, and what is given."""
        given = f", with {listed(self.given)} on a bound" if self.given else ""
        if self.interval is None or self.is_symmetric:
            return self.estimate + given
        known = self.interval.kind != "none"
        interval = f" ({self.interval})" if known else ", no interval"
        return self.estimate + interval + given


def parameter_estimates(
    space: ParameterSpace,
    spread: Uncertainty,
    budget: ErrorBudget,
    start: Float[Array, " n_p"] | None = None,
) -> tuple[ParameterEstimate, ...]:
    """Return values and standard errors of the parameters, in SI units."""
    before = [parameter.start for parameter in space.parameters]
    if start is not None:
        before = np.asarray(space.from_scaled(start))
    errors = budget.standard_errors
    held = tuple(np.array(space.names)[spread.at_bound].tolist())
    return tuple(
        ParameterEstimate(
            name=parameter.name,
            value=float(budget.values[i]),
            standard_error=float(errors[i]),
            start=float(before[i]),
            lower=float(parameter.lower),
            upper=float(parameter.upper),
            unit=parameter.unit,
            at_bound=bool(spread.at_bound[i]),
            given=() if spread.at_bound[i] else held,
        )
        for i, parameter in enumerate(space.parameters)
    )


class Optimum(Module):
    """A point at which converged runs end.

    Attributes:
        cost: Half the sum of squared errors in noise units [-].
        values: Parameters, in SI units.
        starts: Indices of the starts whose runs end here; none if a run only passed it
            on the way to a lower cost.
    """

    cost: float
    values: dict[str, float]
    starts: tuple[int, ...]

    @property
    def words(self) -> str:
        """Its parameters, like "E 1.5e+05, nu 0.45"."""
        return ", ".join(f"{name} {value:.4g}" for name, value in self.values.items())


class MultiStartResult(Result):
    """Result of a search from many starts.

    Attributes:
        names: Names of the parameters.
        starts: Where the runs began, in SI units.
        values: Where they ended, or a known optimum that they led to, in SI units.
        z: The same, scaled [-].
        cost: Half the sum of squared errors in noise units; infinite where the start
            has no equilibrium [-].
        steps: QP steps of each run.
        converged: Whether lambda_p vanished, there or at that optimum.
        errors: Size of the stacked error after each step, in noise units; of a run that
            led to a known optimum, only the steps that were taken [-].
        optima: Distinct ends of the converged runs and of their mirror images, the
            lowest cost first.
    """

    names: tuple[str, ...]
    starts: Float[HostArray, "n_starts n_p"]
    values: Float[HostArray, "n_starts n_p"]
    z: Float[HostArray, "n_starts n_p"]
    cost: Float[HostArray, " n_starts"]
    steps: Int[HostArray, " n_starts"]
    converged: Bool[HostArray, " n_starts"]
    errors: Float[HostArray, "n_starts n_steps"]
    optima: tuple[Optimum, ...]

    @property
    def best(self) -> int:
        """Index of the lowest cost, among the converged runs if any is."""
        return best_of(self.cost, self.converged)

    @property
    def missed(self) -> float:
        """Expected share of random starts that would end at other optima [-].

        That is w (w + 1) / (n (n - 1)) after n independent starts that ended at w
        optima, however many there are (Boender and Rinnooy Kan, Math. Program. 37,
        1987). A run that has not converged counts as an optimum of its own.
        """
        n = int(np.isfinite(self.cost).sum())
        optima = sum(bool(optimum.starts) for optimum in self.optima)
        w = optima + n - int(self.converged.sum())
        return min(w * (w + 1) / (n * (n - 1)), 1.0) if n > 1 else 1.0

    @property
    def second_best(self) -> Optimum | None:
        """The optimum with the lowest cost after the best; None if there is none."""
        return self.optima[1] if len(self.optima) > 1 else None


class CalibrationResult(Result):
    """Outcome of a calibration.

    Attributes:
        converged: Whether lambda_p vanished.
        parameters: The calibrated parameters.
        uncertainty: Their covariance by the noise alone, and what it rests on.
        budget: Their standard errors, split by cause.
        configurations: Fits, then predictions.
        history: One entry per step.
        space: The parameters, with start and bounds.
        model: The model with the calibrated parameters.
        z: Scaled parameters [-].
        linear: The fit to first order with considered errors. All statistics are its
            functions; `result.linear.without("load 3")` is the fit without a pose.
        settings: Settings of the outer loop.
        newton: Settings of the equilibrium.
        precision: Standard error that is asked for, relative to the value [-].
        interrupted: Whether the user has stopped it, with Ctrl-C.
        timing_s: Wall time of "compile" (JAX tracing and compiling) and "solve" [s].
        notes: What the user should know before using the values.
        starts: Result of the search from many starts, if there was one.
        noise: Covariance of the stacked errors that weighed them.
        noise_settled: Whether an estimated noise had settled when the fit ended.
        checks: What the residuals say about the model.
        repeated: Which readings stand in several configurations, in a sentence, or "".
        mistakes: Sentences on mistakes that would explain contradictory data, the
            likeliest first, if they were sought: see `likely_mistakes`.
        left_out: What was not computed; standard errors are then by the noise alone.
        source: The project file that it was made from; None for one made in Python.
    """

    converged: bool
    parameters: tuple[ParameterEstimate, ...]
    uncertainty: Uncertainty
    budget: ErrorBudget
    configurations: tuple[ConfigurationResult, ...]
    history: tuple[HistoryEntry, ...]
    space: ParameterSpace
    model: Model
    z: Float[Array, " n_p"]
    linear: LinearModel
    settings: CalibrationSettings
    newton: NewtonSettings
    timing_s: dict[str, float]
    notes: tuple[str, ...]
    starts: MultiStartResult | None = None
    noise: CorrelatedNoise | None = None
    noise_settled: bool = True
    checks: ResidualChecks | None = None
    precision: float = PRECISION
    interrupted: bool = False
    repeated: str = ""
    mistakes: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    source: ProjectSource | None = None

    @property
    def intervals(self) -> tuple[ParameterInterval, ...]:
        """Confidence intervals of the parameters; empty if none were asked for."""
        return tuple(p.interval for p in self.parameters if p.interval is not None)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Where the model contradicts the data, one sentence each; empty if nowhere.

        They are by chi-squared of stated errors, by `checks`, and by each pose.
        """
        spread, doubts, pushed = self.uncertainty, [], self.pushed
        if pushed:
            doubts.append(
                f"{listed(pushed, MOST_NAMED)} ended on a bound beyond which the data "
                "push, by more than noise explains: widen it, or find what else is "
                "wrong."
            )
        if spread.misfits:
            level = np.sqrt(spread.chi_squared / spread.degrees_of_freedom)
            doubts.append(
                f"The residuals are {level:.2g} times what the stated errors explain "
                f"(chi-squared {spread.chi_squared:.4g} for "
                f"{spread.degrees_of_freedom} degrees of freedom): the model cannot "
                "match the data. Check the law, the mesh, the control points and the "
                "stated noise."
            )
        doubts += self.checks.reasons if self.checks is not None else ()
        for role, done in (("calibration", "fitted "), ("validation", "predicted ")):
            far = [
                (fit.name, fit.rms_after, fit.motion)
                for fit in self.configurations
                if fit.role == role and fit.misfit(spread.noise, spread.level)
            ]
            far.sort(key=lambda pose: -pose[1])
            if far:
                doubts.append(
                    f"{off_by(far, done)}: {'for each, ' * (len(far) > 1)}check its "
                    "load, supports, gravity, units and marker names."
                )
        return tuple(doubts)

    @property
    def pushed(self) -> tuple[str, ...]:
        """Parameters that ended on a bound beyond which the data push.

        Without it the squared errors would fall by more than noise explains: by the
        square of the step to the optimum beyond, in standard errors by noise.
        """
        spread, of, level, pushed = self.uncertainty, None, 1.0, []
        fit = self.linear.of_fit().with_scale(spread.level)
        if spread.noise == "estimated" and spread.has_noise:
            of = spread.degrees_of_freedom
            level = fit.squares() / of  # what offsets of recordings leave of them
        for k in np.flatnonzero(fit.held).tolist():
            p, free = self.parameters[k], fit.with_free(k)
            step, down = free.step()[k], p.value - p.lower < p.upper - p.value
            fall = float(step**2 / free.covariance()[k, k]) / level
            by_chance = chance(fall, 1, of=of, jitter_is_of_all=True)
            if (step < 0.0) == down and by_chance < UNLIKELY:
                pushed.append(p.name)
        return tuple(pushed)

    @property
    def contact_doubts(self) -> tuple[str, ...]:
        """What the model leaves out, and contact that is not as modelled, in sentences.

        That is on obstacles, or where the body passes through itself.
        """
        contacts, fits = self.model.mechanism.contacts, self.configurations
        return *contact_doubts(contacts, fits), *omitted(fits)

    @property
    def missed(self) -> float:
        """Error of all held-out points over their motion; 0 without any [-]."""
        poses = [c for c in self.configurations if c.role == "validation"]
        points = [e for pose in poses if pose.converged for e in pose.points]
        motion = rms_distance(points, lambda e: e.at_rest)
        error = rms_distance(points, lambda e: e.simulated)
        return error / motion if motion > 0.0 else 0.0

    @property
    def contradicted(self) -> bool:
        """Whether the model contradicts the data, fitted or held out."""
        return bool(self.doubts) or self.missed > MISSED

    @property
    def beyond_noise(self) -> bool:
        """Whether residuals are larger than the noise, fitted or held out.

        Where no noise is stated, that the model contradicts the data is all there is.
        """
        spread, checks = self.uncertainty, self.checks
        stated = checks is not None and math.isfinite(checks.level)
        if spread.noise == "estimated" and not stated:
            return self.contradicted
        off = any(fit.misfit(spread.noise, spread.level) for fit in self.configurations)
        large = checks is not None and checks.probability < UNLIKELY
        return off or large or spread.misfits or self.missed > MISSED

    @property
    def estimate(self) -> Estimate:
        """What the calibration says of the parameters, to compare with another's."""
        return Estimate(self.space, self.z, self.budget.covariance, self.contradicted)

    @property
    def _end(self) -> str:
        """How it ended."""
        verdict = "converged" if self.converged else "NOT CONVERGED"
        return f"{verdict} in {len(self.history) - 1} steps"

    def _words(self) -> str:
        return ", ".join([self._end, *(f"{p.name} = {p}" for p in self.parameters)])

    def value(self, name: str) -> float:
        """Return the calibrated value of a parameter.

        Raises:
            ValueError: If no parameter has that name.
        """
        values = {p.name: p.value for p in self.parameters}
        check_known("parameter", values, name)
        return values[name]
