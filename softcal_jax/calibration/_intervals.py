"""Confidence intervals of a finished calibration, by its profile likelihood."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri, stdtrit

from softcal_jax._names import unknown_name
from softcal_jax._typing import Array, Float
from softcal_jax._units import readable_values
from softcal_jax.calibration._build import as_sequence, build_problem
from softcal_jax.calibration._checkpoint import Clock
from softcal_jax.calibration._considered import MESH
from softcal_jax.calibration._evaluation import (
    evaluate,
    weighed,
)
from softcal_jax.calibration._first_order import first_order_holds
from softcal_jax.calibration._problem import without_names
from softcal_jax.calibration._profile import (
    LowerCostFound,
    ProfileEnd,
    profile_ends,
    room_beside,
)
from softcal_jax.calibration._result import (
    CalibrationResult,
    Fitted,
    IntervalKind,
    Optimum,
    ParameterInterval,
)
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import check_converged
from softcal_jax.fields import Parameter
from softcal_jax.inference import EXACT

LEVEL = 0.95
"""Confidence of intervals unless another one is asked for [-]."""

MOST_RETURNS = 3
"""How often a calibration goes on from a lower cost that a profile has found."""


SAME_COST = 1e-4
"""Relative difference of costs that cannot be of the same configurations [-]."""


GoOn = Callable[[Fitted, Float[Array, " n_p"]], Fitted]
"""Continues a calibration from other scaled parameters."""

Told = Callable[[CalibrationResult], None]


def check_level(level: float) -> None:
    """Raise ValueError unless a level of confidence lies between 0 and 1."""
    if not 0.0 < level < 1.0:
        raise ValueError(f"level must lie between 0 and 1, like 0.95; got {level:g}.")


def with_intervals(
    fitted: Fitted, level: float, go_on: GoOn, told: Told
) -> CalibrationResult:
    """Give every parameter the interval that may be printed, or say why it has none.

    Where the cost at the ends of a first-order interval is that of its parabola, see
    `first_order_holds`, that interval is taken; elsewhere the profile of the
    likelihood replaces it, and before `told` is called with the result so far. Where
    either finds a lower cost, the calibration goes on from there.
    """
    first = fitted.result
    with Clock() as clock:
        fitted, found = _settled(fitted, level, go_on, told)
    result = fitted.result
    notes = result.notes
    if result is not first:
        notes += (
            f"While intervals were computed, a lower cost was found than that of the "
            f"first fit, {result.history[-1].cost:.6g} instead of "
            f"{first.history[-1].cost:.6g}: the calibration went on from there.",
        )
    pairs = zip(result.parameters, found, strict=True)
    timing = {k: result.timing_s[k] + more for k, more in clock.seconds.items()}
    return replace(
        result,
        parameters=tuple(replace(own, interval=interval) for own, interval in pairs),
        notes=notes,
        timing_s=timing,
    )


def _settled(
    fitted: Fitted, level: float, go_on: GoOn, told: Told
) -> tuple[Fitted, list[ParameterInterval]]:
    """Return the calibration at the lowest cost that was found, and its intervals."""
    for _ in range(MOST_RETURNS):
        try:
            return fitted, _intervals(fitted, level, told)
        except LowerCostFound as lower:
            other = go_on(fitted, lower.z)
        # Where the noise follows the motion, each fit has weights of its own.
        problem = without_names(fitted.problem)
        cost = weighed(problem, other.result.z, other.evaluation.response).cost
        if not (other.result.converged and float(cost) < float(fitted.evaluation.cost)):
            break
        fitted = other._replace(result=_with_optimum(other.result))
    why = "the cost still falls along its profile: calibrate from more `starts`"
    return fitted, _none(fitted, level, why)


def _with_optimum(result: CalibrationResult) -> CalibrationResult:
    """Put the end of a calibration that went on before the optima of its search."""
    if result.starts is None:
        return result
    own = Optimum(result.history[-1].cost, result.history[-1].values, ())
    optima = (own, *result.starts.optima)
    return replace(result, starts=replace(result.starts, optima=optima))


def _none(fitted: Fitted, level: float, why: str) -> list[ParameterInterval]:
    parameters = fitted.problem.space.parameters
    return [no_interval(own, level=level, why=why) for own in parameters]


def _intervals(fitted: Fitted, level: float, told: Told) -> list[ParameterInterval]:
    """Find the interval of every parameter, or raise `LowerCostFound`."""
    result, spread = fitted.result, fitted.result.uncertainty
    if not result.converged:
        return _none(fitted, level, "the calibration did not converge")
    if not np.isfinite(spread.noise_scale):
        return _none(fitted, level, "too few data to estimate the noise")
    if MESH in result.budget.unknown:
        return _none(fitted, level, "how far the mesh moves it could not be estimated")
    std = np.sqrt(np.diag(spread.covariance))
    known = np.flatnonzero(np.isfinite(std)).tolist()
    bent = np.flatnonzero(spread.at_bound).tolist()
    quantile = _quantile(result, level)
    if spread.noise_scale <= EXACT:
        # The ends are closer to the fit than the equilibria are exact.
        straight, bent = known, []
    else:
        holds = first_order_holds(fitted, quantile, known)
        checked = list(zip(known, holds, strict=True))
        straight = [column for column, good in checked if good]
        bent += [column for column, good in checked if not good]
    intervals = _none(fitted, level, "the data do not determine it")
    for column in np.flatnonzero(spread.at_bound):
        why = "it ended on a bound, and the residuals show no noise"
        intervals[column] = replace(intervals[column], why=why)
    for column in straight:
        end = ProfileEnd(float(quantile * std[column]), "likelihood")
        intervals[column] = _whole(result, column, level, (end, end), first_order=True)
    if bent:
        told(result)
        profiles = profile_ends(
            fitted.problem,
            result.settings,
            z=result.z,
            rows=fitted.evaluation.rows,
            rise=quantile * spread.noise_scale,
            which=bent,
        )
        for column, ends in zip(bent, profiles, strict=True):
            intervals[column] = _whole(result, column, level, ends)
    return intervals


def _quantile(result: CalibrationResult, level: float) -> float:
    """Return how many standard errors chance allows: normal, or Student's t [-]."""
    spread, tail = result.uncertainty, 0.5 * (1.0 + level)
    if spread.noise == "stated":
        return float(ndtri(tail))
    return float(stdtrit(spread.degrees_of_freedom, tail))


def _considered_error(result: CalibrationResult, column: int) -> float:
    """Compute the standard error by what is held fixed and may be wrong [-].

    A parameter on a bound counts as free: its interval ends inside.
    """
    linear = result.linear.with_free(column)
    moved = linear.gain()[column] @ linear.considered.values
    return float(np.nan_to_num(np.linalg.norm(moved)))


def _whole(
    result: CalibrationResult,
    column: int,
    level: float,
    ends: Sequence[ProfileEnd],
    *,
    first_order: bool = False,
) -> ParameterInterval:
    """Make the interval of a parameter from the ends that the noise gives it.

    Both move out by what is held fixed and may be wrong, in squares, up to the bounds.
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
    own, z = result.space.parameters[column], result.z[column]
    return interval_between(own, z, wider, level=level, first_order=first_order)


def profile_intervals(
    result: CalibrationResult,
    configurations: Configuration | Sequence[Configuration],
    *,
    parameters: str | Sequence[str] | None = None,
    level: float = LEVEL,
) -> tuple[ParameterInterval, ...]:
    """Find confidence intervals from the likelihood itself, not its linearisation.

    `calibrate` does this by itself for parameters whose standard error does not hold,
    see its `intervals`; this is for another level, or to compare. A parameter is moved
    away from the fit and held, all others are calibrated again, and the interval ends
    where the squared errors have risen by what chance allows (Bates and Watts,
    Nonlinear Regression Analysis, 1988, sec. 6.1). It need not be symmetric, and may
    end at a bound that the data do not exclude. What is held fixed and may be wrong
    adds to the distance of each end, in squares (see `ErrorBudget`). The confidence is
    that of each interval alone, and other optima than the fit are not searched for.
    Each end takes a few calibrations, and is nan if they do not converge.

    Args:
        result: A calibration that converged.
        configurations: The configurations that were fitted.
        parameters: Names of the parameters that get an interval; all by default.
        level: Confidence [-].

    Raises:
        ValueError: If the calibration did not converge, the configurations are not
            those that it fitted, a parameter is unknown, the level is not between 0 and
            1, or the noise was estimated from too few residuals.
        RuntimeError: If a configuration has no equilibrium with the fitted parameters.
        LowerCostFound: If a fit along the way has a lower cost than the calibration,
            which then is not in the best optimum; the error holds its parameters, to
            calibrate again from.
    """
    space = result.space
    check_level(level)
    if not result.converged:
        raise ValueError(
            "the calibration did not converge, so it has no intervals: raise max_steps "
            "or look at its notes."
        )
    if isinstance(parameters, str):
        parameters = [parameters]
    names = list(space.names if parameters is None else parameters)
    for name in names:
        if name not in space.names:
            raise unknown_name("parameter", name, space.names)
    spread = result.uncertainty
    if spread.noise == "estimated" and spread.degrees_of_freedom < 1:
        raise ValueError(
            "the noise cannot be estimated without more measured coordinates than "
            'parameters: calibrate with noise = "stated", or add measurements.'
        )
    configurations = as_sequence(configurations)
    fitted = [f.name for f in result.configurations if f.role == "calibration"]
    if [c.name for c in configurations] != fitted:
        raise ValueError(
            f"the calibration fitted {', '.join(fitted)}; got "
            f"{', '.join(c.name for c in configurations)}: give those, in that order."
        )
    problem = build_problem(result.model, space, configurations, result.newton)
    problem = problem.with_noise(result.noise)
    now = evaluate(problem, result.z)
    check_converged(now.equilibrium, tuple(c.name for c in configurations))
    cost, before = float(now.cost), result.history[-1].cost
    if not abs(cost - before) <= SAME_COST * before + 1e-9:
        raise ValueError(
            f"the fit has a cost of {before:.6g}, but {cost:.6g} with these "
            "configurations: give those that were calibrated, with their measurements."
        )
    columns = [space.names.index(name) for name in names]
    ends = profile_ends(
        problem,
        result.settings,
        z=result.z,
        rows=now.rows,
        rise=spread.noise_scale * _quantile(result, level),
        which=columns,
    )
    return tuple(
        _whole(result, column, level, pair)
        for column, pair in zip(columns, ends, strict=True)
    )


def interval_between(
    own: Parameter,
    z: Float[Array, ""],
    ends: Sequence[ProfileEnd],
    *,
    level: float,
    first_order: bool = False,
) -> ParameterInterval:
    """Make the interval of a parameter from its lower and its upper end."""
    low, high = ends
    kind, why = _kind(low, high, own, z, first_order)
    return ParameterInterval(
        name=own.name,
        level=level,
        lower=float(own.from_scaled(z - low.distance)),
        upper=float(own.from_scaled(z + high.distance)),
        lower_end=low.why,
        upper_end=high.why,
        unit=own.unit,
        kind=kind,
        why=why,
    )


def no_interval(own: Parameter, *, level: float, why: str) -> ParameterInterval:
    """Make the interval of a parameter that has none."""
    ends = (math.nan, math.nan, "not found", "not found")
    return ParameterInterval(own.name, level, *ends, own.unit, "none", why)


def _kind(low, high, own: Parameter, z, first_order: bool) -> tuple[IntervalKind, str]:
    """Name the kind of an interval, and why it is none."""
    found = [end.why for end in (low, high)]
    if "not found" in found:
        why = "fits along its profile do not converge"
        for end, sign, side in ((low, -1.0, "below"), (high, 1.0, "above")):
            if end.why == "likelihood":
                value = float(own.from_scaled(z + sign * end.distance))
                why += f" (the end {side} is {readable_values([value], own.unit)})"
        return "none", why
    if found == ["bound", "bound"]:
        return "none", "the data exclude no value within its bounds"
    if "bound" in found:
        return "one-sided", ""
    return ("first-order" if first_order else "profile"), ""
