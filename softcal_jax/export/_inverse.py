"""Results of inverse control as a dictionary for JSON."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax.control import OUTCOMES, GoalFit, InverseResult, TrajectoryResult
from softcal_jax.export._made import Made, made_dict, pick, plain


def inverse_dict(
    result: InverseResult | TrajectoryResult,
    *,
    name: str = "inverse",
    timing_s: Mapping[str, float] | None = None,
    made: Made | None = None,
    directory: str | Path = ".",
) -> dict[str, Any]:
    """Build the content of `inverse.json`, in SI and radians.

    Keys: `format`, `name`, `met` (whether all goals are); `source`, `settings` and
    `versions` (see `made_dict`); `points`, one for each goal of a trajectory, else one:
    `configuration` (its name), `met`, `outcome` and `message` in words, `tol`, the
    error at which a goal counts as met, in standard deviations; `goals` (`name`,
    `unit`, `is_turn`, `priority`, `met`, `goal`, `reached`, `residual`, `std`,
    `in_std`: residual over std; null for a coordinate without a goal; turns are counted
    from the goal); `actuators` (`name`, `kind`, `commanded`, `imposed`, `force`,
    `force_unit`, `displacement`, `displacement_unit`, null without one);
    `active_limits` and `held_by` in words; `blind` (null without; `coordinates`,
    `units`, `direction`, `off`, `gain`); `attempts` (`way`, `outcome`, `error` in
    standard deviations, `n_steps`); `steps` of the search. Then `timing_s` [s].
    """
    points = [result] if isinstance(result, InverseResult) else result.points
    model = points[0].model if points else None
    if made is None and model is not None:
        made = Made(model, {})
    return plain(
        {
            "format": "softcal_jax.inverse/1",
            "name": name,
            "met": all(point.met for point in points),
            **made_dict(made, directory),
            "points": [_point(point) for point in points],
            "timing_s": timing_s or {},
        }
    )


def _point(result: InverseResult) -> dict[str, Any]:
    return {
        "configuration": result.configuration.name,
        **pick(result, "met", "message", "tol"),
        "outcome": OUTCOMES[result.outcome],
        "goals": [_goal(fit, result.tol) for fit in result.goals],
        "actuators": [
            {"commanded": own.name in result.configuration.actuation, **plain(own)}
            for own in result.actuators
        ],
        **pick(result, "active_limits", "held_by", "blind"),
        "attempts": [
            {
                **pick(own, "way", "error", "n_steps"),
                "outcome": None if own.outcome is None else OUTCOMES[own.outcome],
            }
            for own in result.attempts
        ],
        "steps": result.steps,
    }


def _goal(fit: GoalFit, tol: float) -> dict[str, Any]:
    own, seen = fit.effector, fit.effector.seen
    asked = lambda values: np.where(seen, values, np.nan)
    return {
        **pick(own, "name", "unit", "is_turn"),
        "priority": fit.priority,
        "met": bool(np.max(np.abs(fit.in_std), initial=0.0) <= tol),
        "goal": asked(own.measured),
        "reached": fit.reached,
        "residual": asked(fit.residual),
        "std": own.std,
        "in_std": asked(fit.in_std),
    }
