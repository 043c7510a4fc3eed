"""Intervals that a calibration prints: of first order where that holds, or profiles."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.special import ndtri, stdtrit

from softcal_jax._process import Clock
from softcal_jax._text import MOST_NAMED, listed
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax._units import readable, readable_values
from softcal_jax.calibration._evaluation import Evaluation, Evaluator, weighed
from softcal_jax.calibration._profile import (
    LOWER,
    Ends,
    LowerCostFound,
    ProfileEnd,
    profile_ends,
    room_beside,
)
from softcal_jax.calibration._result import (
    CalibrationResult,
    IntervalKind,
    Optimum,
    ParameterInterval,
)
from softcal_jax.equilibrium import Workers
from softcal_jax.fields import WEAK_UP_TO, Parameter, ParameterSpace, asked_errors
from softcal_jax.inference import EXACT, LinearModel
from softcal_jax.unknowns import Problem

LEVEL = 0.95
"""Confidence of intervals unless another one is asked for [-]."""

MOST_RETURNS = 3
"""How often a calibration goes on from a lower cost that a profile has found."""

CURVED = 0.1
"""Relative error of the root of the rise at which an end is no longer first-order [-].

On a parabola the root of the rise of twice the cost is the distance over the standard
error. With both ends a tenth too close to the fit, an interval that says 95 % holds
92 % of the time; with one too close and the other too far, 94 %. Of the distance, it is
also the error at which a profile agrees with the linear model.
"""

PAIR = 2
"""Profiles at a time; if all of them agree with the linear model, no more are made."""


class Fitted(NamedTuple):
    """A calibration at its end, and what its intervals are computed from."""

    result: CalibrationResult
    problem: Problem
    evaluation: Evaluation

    def profile_ends(
        self, level: float, which: Sequence[int], **options: Any
    ) -> list[Ends]:
        """Find how far parameters can move, see the function of this name."""
        result, problem, evaluation = self
        return profile_ends(
            problem,
            result.settings,
            z=result.z,
            linear=evaluation.linear(problem, result.z),
            rise=result.uncertainty.noise_scale * quantile_of(result, level),
            which=which,
            **options,
        )


def _first_order_holds(
    fitted: Fitted, quantile: float, which: Sequence[int]
) -> list[bool]:
    """Check the cost at both ends of the first-order intervals of parameters.

    A parameter is moved by `quantile` standard errors, and the others with it along its
    column of the covariance, as on the profile of a parabola. There the root of the
    rise of twice the cost must be the quantile within `CURVED`, also once the others
    have taken one more Gauss-Newton step: the first test sees a valley that bends, the
    second a floor that falls off. One evaluation for each end, all side by side.
    """
    result, problem, evaluation = fitted
    linear = result.linear.of_fit()

    def about(z: Float[Array, " n_p"], end: Evaluation) -> LinearModel:
        return end.linear(problem, z).with_scale(linear.scale)

    sides = [(column, sign) for column in which for sign in (-1, 1)]
    lanes = len(sides) * problem.n_fitted
    with Workers(problem.model, max(lanes, 1)) as workers:
        holds = partial(
            _end_holds,
            evaluate=Evaluator(problem, workers),
            about=about,
            space=problem.space,
            z=np.asarray(result.z),
            evaluation=evaluation,
            linear=linear,
            quantile=quantile,
        )
        ends = workers.side_by_side(partial(holds, *side) for side in sides)
    return [low and high for low, high in zip(ends[::2], ends[1::2], strict=True)]


def _end_holds(
    column: int,
    sign: int,
    *,
    evaluate: Callable[..., Evaluation],
    about: Callable[[Float[Array, " n_p"], Evaluation], LinearModel],
    space: ParameterSpace,
    z: HostArray,
    evaluation: Evaluation,
    linear: LinearModel,
    quantile: float,
) -> bool:
    """Check one end; `about` gives the linear model elsewhere, with the same noise."""
    covariance = linear.covariance()
    free = linear.known
    std = np.sqrt(covariance[column, column])
    if quantile * std >= room_beside(space, z, column, sign):
        return False
    step = np.where(free, sign * quantile * covariance[column] / std, 0.0)
    down, up = map(np.asarray, space.room(jax.device_put(z)))
    step = np.clip(step, down, up)
    # Moduli must stay in their order.
    A, b = map(np.asarray, space.rows())
    at_end, chart = z + step, space.chart
    crossed = chart is not None and np.any(at_end[chart.small] > at_end[chart.large])
    if crossed or np.any(A @ at_end > b):
        return False
    z_end = jax.device_put(at_end)
    end = evaluate(z_end, evaluation.response.equilibrium.displacement)
    if not end.ok:
        return False
    rise_of_end, cost = (quantile * linear.scale) ** 2, float(evaluation.cost)
    if float(end.cost) < cost - 0.5 * LOWER * rise_of_end:
        raise LowerCostFound(z_end, float(end.cost), cost)
    moved = about(z_end, end)
    # The fit stops where its slope has nearly vanished, and what is left counts here.
    slope = np.where(linear.held, 0.0, linear.slope())
    rise = moved.squares() - linear.squares() - 2.0 * slope @ step
    left = moved.slope() - slope
    # A parameter on a bound may leave it again, now that the tested one has moved.
    leaves = np.where(left < 0.0, up > 0.0, down < 0.0) & linear.held
    others = np.flatnonzero((free & (step > down) & (step < up)) | leaves)
    others = others[others != column]
    left = left[others]
    curvature = moved.curvature()[np.ix_(others, others)]
    fall = left @ np.linalg.lstsq(curvature, left, rcond=None)[0] if len(left) else 0.0
    roots = np.sqrt(np.maximum([rise, rise - fall], 0.0))
    return bool(np.all(np.abs(roots - quantile) <= CURVED * quantile))


INTERRUPTED = "its profile was interrupted"
"""Why a parameter has no interval after Ctrl-C."""

GoOn = Callable[[Fitted, Float[Array, " n_p"]], Fitted]
Stage = Callable[[str], None]

LEVELS = 0.01, 0.9999
"""Levels of confidence for which an interval means something; both are allowed [-]."""


def check_level(level: float) -> None:
    """Raise ValueError unless a level of confidence is one of `LEVELS`."""
    low, high = LEVELS
    if not low <= level <= high:
        raise ValueError(
            f"level must lie between {low:g} and {high:g}, e.g. 0.95; got {level:g}."
        )


def with_intervals(
    fitted: Fitted, level: float, go_on: GoOn, stage: Stage
) -> CalibrationResult:
    """Give every parameter the interval that may be printed, or say why it has none.

    Where the cost at the ends of a first-order interval is that of its parabola, see
    `_first_order_holds`, that interval is taken; elsewhere the profile of the
    likelihood replaces it. `stage` is called before each of these. Where either finds a
    lower cost, the calibration goes on from there.
    """
    first = fitted.result
    with Clock() as clock:
        fitted, intervals = _settled(fitted, level, go_on, stage)
    result, notes = fitted.result, fitted.result.notes
    interrupted = any(interval.why == INTERRUPTED for interval in intervals)
    if interrupted:
        notes += ("Interrupted before the intervals of all parameters were known.",)
    if result is not first:
        notes += (
            "While intervals were computed, a lower cost than in the first fit was "
            f"found ({result.history[-1].cost:.6g} instead of "
            f"{first.history[-1].cost:.6g}); the calibration continued from there.",
        )
    pairs = zip(result.parameters, intervals, strict=True)
    timing = {k: result.timing_s[k] + more for k, more in clock.seconds.items()}
    return replace(
        result,
        parameters=tuple(replace(p, interval=interval) for p, interval in pairs),
        notes=notes,
        timing_s=timing,
        interrupted=result.interrupted or interrupted,
    )


def _settled(
    fitted: Fitted, level: float, go_on: GoOn, stage: Stage
) -> tuple[Fitted, list[ParameterInterval]]:
    """Return the calibration at the lowest cost that was found, and its intervals."""
    for _ in range(MOST_RETURNS):
        try:
            return fitted, _intervals(fitted, level, stage)
        except LowerCostFound as lower:
            other = go_on(fitted, lower.z)
        # Where the noise follows the motion, each fit has weights of its own.
        problem = fitted.problem.numbered
        cost = weighed(problem, other.result.z, other.evaluation.response).cost
        if not (other.result.converged and float(cost) < float(fitted.evaluation.cost)):
            break
        fitted, search = other, other.result.starts
        if search is not None:
            last = other.result.history[-1]
            optima = (Optimum(last.cost, last.values, ()), *search.optima)
            search = replace(search, optima=optima)
            fitted = other._replace(result=replace(other.result, starts=search))
    why = "the cost still decreases along its profile: calibrate from more `starts`"
    return fitted, _none(fitted, level, why)


def _none(fitted: Fitted, level: float, why: str) -> list[ParameterInterval]:
    """Make intervals of parameters that have none."""
    ends = (math.nan, math.nan, "not found", "not found")
    return [
        ParameterInterval(parameter.name, level, *ends, parameter.unit, "none", why)
        for parameter in fitted.problem.space.parameters
    ]


def _intervals(fitted: Fitted, level: float, stage: Stage) -> list[ParameterInterval]:
    """Find the interval of every parameter, or raise `LowerCostFound`."""
    result, spread = fitted.result, fitted.result.uncertainty
    if not result.converged:
        return _none(fitted, level, "the calibration did not converge")
    if not np.isfinite(spread.noise_scale):
        return _none(fitted, level, "too few data to estimate the noise")
    std = np.sqrt(np.diag(spread.covariance))
    known = np.flatnonzero(np.isfinite(std)).tolist()
    bent = np.flatnonzero(spread.at_bound).tolist()
    quantile = quantile_of(result, level)
    if spread.noise_scale <= EXACT:
        # The ends are closer to the fit than the equilibria are exact.
        straight, bent = known, []
    else:
        stage("the intervals of the parameters, one evaluation per end")
        holds = _first_order_holds(fitted, quantile, known)
        checked = list(zip(known, holds, strict=True))
        straight = [column for column, good in checked if good]
        bent += [column for column, good in checked if not good]
    intervals = _none(fitted, level, "the data do not determine it")
    for column in np.flatnonzero(spread.at_bound):
        why = "it ended on a bound, and the residuals show no noise"
        intervals[column] = replace(intervals[column], why=why)
    linear = {
        column: _linear_ends(result, column, float(quantile * std[column]))
        for column in straight + bent
    }
    for column in straight:
        ends = linear[column]
        intervals[column] = whole_interval(result, column, level, ends, "first-order")
    with suppress(KeyboardInterrupt):
        # The least certain first, since Ctrl-C keeps the intervals found before it.
        bent.sort(key=lambda column: -np.nan_to_num(std[column]))
        _by_profile(fitted, level, bent, linear, intervals, stage)
    return intervals


def _linear_ends(result: CalibrationResult, column: int, reach: float) -> Ends:
    """Return the ends that the linear model foretells; NaN for what it knows not."""
    rooms = (room_beside(result.space, result.z, column, sign) for sign in (-1, 1))
    low, high = (
        ProfileEnd(float(np.minimum(reach, r)), "bound" if reach >= r else "likelihood")
        for r in rooms
    )
    return low, high


def _unidentified(
    result: CalibrationResult, which: Sequence[int], linear: dict[int, Ends]
) -> list[int]:
    """Pick what the linear model cannot identify, or takes to the bounds."""
    asked = asked_errors(result.space, result.z, result.precision, model=result.model)
    far = np.sqrt(np.diag(result.uncertainty.covariance)) > WEAK_UP_TO * asked
    beyond = lambda column: all(end.why == "bound" for end in linear[column])
    return [column for column in which if far[column] or beyond(column)]


def _allowed(
    fitted: Fitted, level: float, which: Sequence[int]
) -> Iterator[tuple[int, ParameterInterval]]:
    """Yield the parameters of which the data allow a bound; they have no interval."""
    every = fitted.profile_ends(level, which, only_bounds=True)
    for column, ends in zip(which, every, strict=True):
        interval = whole_interval(fitted.result, column, level, ends)
        whys = [end.why for end in ends]
        if {*whys} == {"likelihood", "bound"}:
            value = interval.lower if whys[0] == "bound" else interval.upper
            why = "the data hardly determine it: they allow "
            why += readable(value, interval.unit)
            interval = replace(interval, kind="none", why=why)
        if {*whys} != {"likelihood"}:
            yield column, interval


def _by_profile(
    fitted: Fitted,
    level: float,
    which: Sequence[int],
    linear: dict[int, Ends],
    intervals: list[ParameterInterval],
    stage: Stage,
) -> None:
    """Replace intervals by those of profiles, in the order of `which`, until Ctrl-C.

    What the `linear` model cannot identify is checked at its bounds, and profiled only
    if the data exclude both. Profiles follow `PAIR` by `PAIR`, however many cores there
    are, until all of a pair agree with the linear model; those that are left are taken
    from it.
    """
    result, none = fitted.result, (ProfileEnd(0.0, "likelihood"),) * 2
    # Where errors of what is held fixed reach both bounds, the noise does not matter.
    for column in which:
        intervals[column] = whole_interval(result, column, level, none)
    left = [column for column in which if intervals[column].kind != "none"]
    for column in left:
        intervals[column] = replace(intervals[column], kind="none", why=INTERRUPTED)
    unseen = _unidentified(result, left, linear)
    named = lambda columns: listed([result.space.names[c] for c in columns], MOST_NAMED)

    def keep(column: int, ends: Ends) -> None:
        intervals[column] = whole_interval(result, column, level, ends)
        stage(f"the intervals by profile likelihood, after that of {named([column])}")

    if unseen:
        stage(f"whether the data allow the bounds of {named(unseen)}")
        for column, intervals[column] in _allowed(fitted, level, unseen):
            left.remove(column)
    if left:
        stage(f"the intervals of {named(left)} by profile likelihood")
    while left:
        pair, left = left[:PAIR], left[PAIR:]
        every = fitted.profile_ends(level, pair, ended=keep)
        found = np.array([[end.distance for end in ends] for ends in every])
        by_linear = np.array([[end.distance for end in linear[c]] for c in pair])
        if len(pair) == PAIR and np.all(abs(found / by_linear - 1.0) <= CURVED):
            break
    for column in left:
        ends = linear[column]
        intervals[column] = whole_interval(result, column, level, ends, "first-order")


def quantile_of(result: CalibrationResult, level: float) -> float:
    """Return the two-sided quantile of a level, normal or of Student's t [-]."""
    spread, tail = result.uncertainty, 0.5 * (1.0 + level)
    if spread.noise == "stated":
        return float(ndtri(tail))
    return float(stdtrit(spread.degrees_of_freedom, tail))


def _considered_error(result: CalibrationResult, column: int) -> float:
    """Compute the standard error by errors of what is held fixed [-].

    A parameter on a bound counts as free, since its interval ends inside the bounds.
    """
    linear = result.linear.with_free(column)
    moved = linear.gain()[column] @ linear.considered.values
    return float(np.nan_to_num(np.linalg.norm(moved)))


def whole_interval(
    result: CalibrationResult,
    column: int,
    level: float,
    ends: Sequence[ProfileEnd],
    kind: IntervalKind = "profile",
) -> ParameterInterval:
    """Make the interval of a parameter from its ends by the noise alone.

    Errors of what is held fixed move both outwards, in quadrature, up to the bounds.
    """
    reach = ndtri(0.5 * (1.0 + level)) * _considered_error(result, column)
    wider = []
    for end, sign in zip(ends, (-1, 1), strict=True):
        room = room_beside(result.space, result.z, column, sign)
        distance = float(np.hypot(end.distance, reach))
        if end.why == "likelihood" and distance >= room:
            wider.append(ProfileEnd(room, "bound"))
        else:
            wider.append(end if end.why == "bound" else ProfileEnd(distance, end.why))
    parameter = result.space.parameters[column]
    z = float(np.asarray(result.z)[column])
    return interval_between(parameter, z, wider, level=level, kind=kind)


def interval_between(
    parameter: Parameter,
    z: float,
    ends: Sequence[ProfileEnd],
    *,
    level: float,
    kind: IntervalKind = "profile",
) -> ParameterInterval:
    """Make the interval of a parameter from its lower and its upper end."""
    low, high = ends
    moved = lambda by: jax.device_put(np.asarray(z + by))
    value_at = lambda by: float(parameter.from_scaled(moved(by)))
    whys: list[str] = [end.why for end in ends]
    why = ""
    if "not found" in whys:
        kind, why = "none", "fits along its profile do not converge"
        for end, sign, side in ((low, -1.0, "below"), (high, 1.0, "above")):
            if end.why == "likelihood":
                values = [value_at(sign * end.distance)]
                why += f" (the end {side} is {readable_values(values, parameter.unit)})"
    elif whys == ["bound", "bound"]:
        kind, why = "none", "the data exclude no value within its bounds"
    elif "bound" in whys:
        kind = "one-sided"
    return ParameterInterval(
        name=parameter.name,
        level=level,
        lower=value_at(-low.distance),
        upper=value_at(high.distance),
        lower_end=low.why,
        upper_end=high.why,
        unit=parameter.unit,
        kind=kind,
        why=why,
    )
