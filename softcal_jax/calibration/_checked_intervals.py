"""The intervals that a calibration prints: to first order where that holds, or not."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri, stdtrit

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._checkpoint import Clock
from softcal_jax.calibration._considered import MESH
from softcal_jax.calibration._evaluation import Evaluation, in_other_units
from softcal_jax.calibration._first_order import first_order_holds
from softcal_jax.calibration._interval import (
    ParameterInterval,
    ProfileEnd,
    interval_between,
    no_interval,
)
from softcal_jax.calibration._problem import CalibrationProblem, without_names
from softcal_jax.calibration._profile import LowerCostFound, profile_ends, room_beside
from softcal_jax.calibration._result import CalibrationResult, Optimum
from softcal_jax.configurations import Configuration
from softcal_jax.inference import EXACT

LEVEL = 0.95
"""Confidence of intervals unless another one is asked for [-]."""

MOST_RETURNS = 3
"""How often a calibration goes on from a lower cost that a profile has found."""


class Fitted(NamedTuple):
    """A calibration at its end, and what its intervals are computed from."""

    result: CalibrationResult
    problem: CalibrationProblem
    configurations: tuple[Configuration, ...]
    evaluation: Evaluation


GoOn = Callable[[Fitted, Float[Array, " n_p"]], Fitted]
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
    `first_order_holds`, that interval is taken; elsewhere the profile of the likelihood
    replaces it. Where either finds a lower cost, the calibration goes on from there.

    Args:
        fitted: The calibration.
        level: Confidence [-].
        go_on: Continues a calibration from other scaled parameters.
        told: Called with the result so far before profiles are computed.
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
        cost = in_other_units(problem, other.result.z, other.evaluation).cost
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
    """Find the interval of every parameter.

    Raises:
        LowerCostFound: If a cost is lower than that of the calibration.
    """
    result, problem, configurations, at = fitted
    spread = result.uncertainty
    if not result.converged:
        return _none(fitted, level, "the calibration did not converge")
    if not np.isfinite(spread.noise_scale):
        return _none(fitted, level, "too few data to estimate the noise")
    if MESH in result.budget.unknown:
        return _none(fitted, level, "how far the mesh moves it could not be estimated")
    std = np.sqrt(np.diag(spread.covariance))
    known = np.flatnonzero(np.isfinite(std)).tolist()
    bent = np.flatnonzero(spread.at_bound).tolist()
    quantile = quantile_of(result, level)
    if spread.noise_scale <= EXACT:
        # The ends are closer to the fit than the equilibria are exact.
        straight, bent = known, []
    else:
        holds = first_order_holds(
            problem,
            configurations,
            z=result.z,
            at=at,
            linear=result.linear.of_fit(),
            quantile=quantile,
            which=known,
        )
        checked = list(zip(known, holds, strict=True))
        straight = [column for column, good in checked if good]
        bent += [column for column, good in checked if not good]
    found: dict[int, ParameterInterval] = {}
    for column in straight:
        reach = float(quantile * std[column])
        ends = ProfileEnd(reach, "likelihood"), ProfileEnd(reach, "likelihood")
        found[column] = whole_interval(result, column, level, ends, first_order=True)
    profiles = []
    if bent:
        told(result)
        profiles = profile_ends(
            problem,
            result.settings,
            z=result.z,
            rows=at.rows,
            rise=quantile * spread.noise_scale,
            which=bent,
        )
    for column, ends in zip(bent, profiles, strict=True):
        found[column] = whole_interval(result, column, level, ends)
    for column in range(len(std)):
        if column not in found:
            found[column] = _no(fitted, column, level, _blind(result, column))
    return [found[column] for column in range(len(std))]


def _blind(result: CalibrationResult, column: int) -> str:
    if result.uncertainty.at_bound[column]:
        return "it ended on a bound, and the residuals show no noise"
    return "the data do not determine it"


def _no(fitted: Fitted, column: int, level: float, why: str) -> ParameterInterval:
    return no_interval(fitted.problem.space.parameters[column], level=level, why=why)


def quantile_of(result: CalibrationResult, level: float) -> float:
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


def whole_interval(
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
