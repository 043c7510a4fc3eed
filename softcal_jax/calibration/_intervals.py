"""Confidence intervals of a finished calibration, by its profile likelihood."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import norm, t

from softcal_jax._names import unknown_name
from softcal_jax.calibration._calibrate import as_sequence, build_problem
from softcal_jax.calibration._problem import Evaluator
from softcal_jax.calibration._profile import ProfileEnd, profile_ends, room_beside
from softcal_jax.calibration._result import CalibrationResult, ParameterInterval
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Workers, check_converged

SAME_COST = 1e-4
"""Relative difference of costs that cannot be of the same configurations [-]."""


def profile_intervals(
    result: CalibrationResult,
    configurations: Configuration | Sequence[Configuration],
    *,
    parameters: str | Sequence[str] | None = None,
    level: float = 0.95,
) -> tuple[ParameterInterval, ...]:
    """Find confidence intervals from the likelihood itself, not its linearisation.

    Value +- 1.96 standard errors holds where the errors are linear in the parameters
    over that range. Where the data determine a parameter only to a third of its value
    or worse, they are not. Here a parameter is moved away from the fit and held, all
    others are calibrated again, and the interval ends where the squared errors have
    risen by what chance allows (Bates and Watts, Nonlinear Regression Analysis, 1988,
    sec. 6.1). It need not be symmetric, and may end at a bound that the data do not
    exclude. What is held fixed and may be wrong adds to the distance of each end, in
    squares, as it does to the standard error (see `ErrorBudget`). The confidence is
    that of each interval alone, not of all together, and other optima than the fit are
    not searched for. Each end takes a few calibrations from near their optimum, and is
    nan if they do not converge.

    Args:
        result: A calibration that converged.
        configurations: The configurations that were fitted.
        parameters: Names of the parameters that get an interval; all by default.
        level: Confidence [-].

    Raises:
        ValueError: If the calibration did not converge, the configurations are not
            those that it fitted, a parameter is unknown, the level is not between 0 and
            1, or the noise was estimated from too few residuals, or with a prior.
        RuntimeError: If a configuration has no equilibrium with the fitted parameters.
        LowerCostFound: If a fit along the way has a lower cost than the calibration,
            which then is not in the best optimum; the error holds its parameters, to
            calibrate again from.
    """
    space = result.space
    if not 0.0 < level < 1.0:
        raise ValueError(f"level must lie between 0 and 1, like 0.95; got {level:g}.")
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
    rise = _rise(result, level)
    configurations = as_sequence(configurations)
    fitted = [f.name for f in result.configurations if f.role == "calibration"]
    if [c.name for c in configurations] != fitted:
        raise ValueError(
            f"the calibration fitted {', '.join(fitted)}; got "
            f"{', '.join(c.name for c in configurations)}: give those, in that order."
        )
    problem = build_problem(result.model, space, configurations, result.newton)
    problem = problem.with_noise(result.noise)
    with Workers(problem.model, len(problem.configurations.gravity)) as workers:
        now = workers.end_of(Evaluator(problem).from_rest(result.z))
    check_converged(now.equilibrium, tuple(c.name for c in configurations))
    cost, before = float(now.cost), result.history[-1].cost
    if not abs(cost - before) <= SAME_COST * before + 1e-9:
        raise ValueError(
            f"the fit has a cost of {before:.6g}, but {cost:.6g} with these "
            "configurations: give those that were calibrated, with their measurements."
        )
    ends = profile_ends(
        problem,
        result.settings,
        z=result.z,
        W_ep=np.asarray(now.W_ep),
        cost=cost,
        rise=rise,
        which=[space.names.index(name) for name in names],
    )
    intervals = []
    for name, pair in zip(names, ends, strict=True):
        column = space.names.index(name)
        low, high = _widened(result, column, level, *pair)
        own, z = space.parameters[column], result.z[column]
        intervals.append(
            ParameterInterval(
                name=name,
                level=level,
                lower=float(own.from_scaled(z - low.distance)),
                upper=float(own.from_scaled(z + high.distance)),
                lower_end=low.why,
                upper_end=high.why,
                unit=own.unit,
            )
        )
    return tuple(intervals)


def _rise(result: CalibrationResult, level: float) -> float:
    """Return the root of the rise of the squared errors that chance allows."""
    spread, tail = result.uncertainty, 0.5 * (1.0 + level)
    if spread.noise == "stated":
        return float(norm.ppf(tail))
    if result.space.has_prior:
        raise ValueError(
            "intervals beside a prior need to know the noise: calibrate with "
            'noise = "stated" and the `std` of the effectors.'
        )
    if spread.degrees_of_freedom < 1:
        raise ValueError(
            "the noise cannot be estimated without more measured coordinates than "
            'parameters: calibrate with noise = "stated", or add measurements.'
        )
    return float(spread.noise_scale * t.ppf(tail, spread.degrees_of_freedom))


def _widened(
    result: CalibrationResult, column: int, level: float, *ends: ProfileEnd
) -> list[ProfileEnd]:
    """Move both ends out by what is held fixed and may be wrong, up to the bounds."""
    # What the likelihood knows of already is in the covariance by the noise.
    both = result.budget.covariance, result.uncertainty.covariance
    variance = max(both[0][column, column] - both[1][column, column], 0.0)
    reach = norm.ppf(0.5 * (1.0 + level)) * np.sqrt(np.nan_to_num(variance))
    wider = []
    for end, sign in zip(ends, (-1, 1), strict=True):
        room = room_beside(result.space, result.z, column, sign)
        distance = np.hypot(end.distance, reach)
        if end.why == "likelihood" and distance >= room:
            wider.append(ProfileEnd(room, "bound"))
        else:
            wider.append(end if end.why == "bound" else ProfileEnd(distance, end.why))
    return wider
