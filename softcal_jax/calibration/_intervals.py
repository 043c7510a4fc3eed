"""Confidence intervals of a finished calibration, by its profile likelihood."""

from collections.abc import Sequence

from softcal_jax._names import unknown_name
from softcal_jax.calibration._calibrate import as_sequence, build_problem
from softcal_jax.calibration._checked_intervals import (
    LEVEL,
    check_level,
    quantile_of,
    whole_interval,
)
from softcal_jax.calibration._evaluation import evaluate
from softcal_jax.calibration._profile import profile_ends
from softcal_jax.calibration._result import CalibrationResult, ParameterInterval
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import check_converged

SAME_COST = 1e-4
"""Relative difference of costs that cannot be of the same configurations [-]."""


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
        rise=spread.noise_scale * quantile_of(result, level),
        which=columns,
    )
    return tuple(
        whole_interval(result, column, level, pair)
        for column, pair in zip(columns, ends, strict=True)
    )
