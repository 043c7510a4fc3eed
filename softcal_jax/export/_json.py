"""Results as dictionaries for JSON: positions in mm, the rest in SI, angles in rad.

`KEYS` says what is written of each class. They hold dictionaries, lists, texts, numbers
and None, which stands for every number that is missing or not finite.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax._module import Result
from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    SimulationResult,
)
from softcal_jax.control import OUTCOMES, GoalFit, InverseResult, TrajectoryResult
from softcal_jax.designs import DesignResult
from softcal_jax.equilibrium import Model
from softcal_jax.export._headlines import headline, missed_words
from softcal_jax.export._made import Made, made_dict, pick, plain
from softcal_jax.identifiability import Assessment, Identifiability, Ranking, assess
from softcal_jax.inference import ErrorBudget
from softcal_jax.layouts import LEVEL_OF_COMPARISON, ModelComparison

RESULT_FORMAT = "softcal_jax.result/2"
"""Format of `result.json`."""


def result_dict(
    result: Result,
    *,
    name: str = "",
    assessment: Assessment | None = None,
    ranking: Ranking | None = None,
    timing_s: Mapping[str, float] | None = None,
    made: Made | Mapping[str, Made] | None = None,
    directory: str | Path = ".",
) -> dict[str, Any]:
    """Convert a result to the content of its JSON file, see `KEYS`.

    In the `goals` of inverse control, `in_std` is residual over std, a coordinate
    without a goal has null, and turns are counted from the goal; its `actuators` say
    whether they are `commanded`. Scores and differences of models are squares in units
    of the noise; `best` is null if no model predicts everything.

    Args:
        result: The result.
        name: Its name; by default its kind.
        assessment: That of a calibration, if known already.
        ranking: Candidates that are ranked beside an `Identifiability`.
        timing_s: Wall times of further parts [s].
        made: What it was computed from and with; a calibration knows that, of models
            that are compared by their names.
        directory: The folder that paths of files are relative to.

    Raises:
        TypeError: If it is no result that is written to a folder.
    """
    times = {**(timing_s or {})}
    match result:
        case CalibrationResult():
            kind, assessment = "result/2", assessment or assess(result)
            with np.errstate(invalid="ignore", divide="ignore"):
                content = plain(result)  # an exact fit has no spread
            content |= {
                "solver": solver_dict(result.model),
                "budget": _budget(result.budget),
                "assessment": assessment,
                "identifiability": assessment.identifiability,
            }
            settings = {"calibration": result.settings, "newton": result.newton}
            settings["noise"] = result.uncertainty.noise
            made = Made(result.model, settings, result.source)
            times = result.timing_s | times
        case SimulationResult():
            kind, content = "simulation/1", _simulation(result)
            made = made or Made(result.model, {})
        case DesignResult():
            kind = "design/1"
            content = {**_simulation(bodies_of(result)), "design": _design(result)}
        case InverseResult() | TrajectoryResult():
            points = [result] if isinstance(result, InverseResult) else result.points
            met = all(point.met for point in points)
            kind, content = "inverse/1", {"met": met, "points": [*map(_point, points)]}
            made = made or Made(points[0].model, {})
        case ModelComparison():
            kind, made = "comparison/1", made or {}
            content = {
                "verdict": headline(result),
                **pick(result, "undecided models differences"),
                "best": result.best and result.best.name,
                "level": LEVEL_OF_COMPARISON,
            }
        case Identifiability() | Ranking():
            kind, content = "identifiability/3", _outlook(result, ranking)
        case _:
            raise TypeError(f"a {type(result).__name__} is no result that is written.")
    return plain(
        {
            "format": f"softcal_jax.{kind}",
            "name": name or kind.partition("/")[0].replace("result", "calibration"),
            **made_dict(made, directory),
            **content,
            "timing_s": times,
        }
    )


def _budget(budget: ErrorBudget) -> dict[str, Any]:
    by_cause, total = budget.by_cause(), budget.standard_errors
    return {
        "parameters": [
            {
                "name": name,
                "unit": budget.units[i],
                "standard_error": total[i],
                "by_cause": {cause: std[i] for cause, std in by_cause.items()},
                "sentence": budget.sentence(name),
            }
            for i, name in enumerate(budget.names)
        ],
        "errors": [
            {
                "cause": cause.name,
                "name": error,
                "deviations": budget.slopes * cause.deviations[:, k],
            }
            for cause in budget.causes
            for k, error in enumerate(cause.errors)
        ],
        "covariance": budget.covariance,
    }


def _outlook(
    result: Identifiability | Ranking, ranking: Ranking | None
) -> dict[str, Any]:
    outlook = None if isinstance(result, Ranking) else result
    ranked = result if isinstance(result, Ranking) else ranking
    budget = outlook and outlook.budget and _budget(outlook.budget)
    left = ranked.unranked.items() if ranked else ()
    said = ranked and {
        "candidates": ranked.gains,
        "reached": ranked.reached,
        "unranked": [{"name": name, "reason": reason} for name, reason in left],
    }
    return {"identifiability": outlook, "budget": budget, "ranking": said}


def bodies_of(result: DesignResult) -> SimulationResult:
    """Return the equilibria of a design, as those of a simulation."""
    posed = [replace(pose, role="design") for pose in result.fit.configurations]
    return SimulationResult(result.fit.model, tuple(posed))


def _simulation(result: SimulationResult) -> dict[str, Any]:
    return {
        **pick(result, "converged doubts"),
        "configurations": [_simulated(c) for c in result.configurations],
        "solver": solver_dict(result.model),
    }


def _simulated(result: ConfigurationResult) -> dict[str, Any]:
    entry = pick(
        result,
        "name role converged outcome newton_steps load_steps residual rounding "
        "at_rounding min_det_F largest_displacement_mm rms_after_mm motion_mm",
    )
    entry["markers"] = [
        pick(e, "name at_rest_mm measured_mm simulated_mm") for e in result.points
    ]
    entry["effectors"] = [
        pick(e, "name unit is_turn measured simulated") for e in result.others
    ]
    entry["robot"] = result.robot
    if result.role == "simulation":  # nothing was measured
        entry |= {"rms_after_mm": None, "motion_mm": None}
    if not result.converged:
        entry |= {"largest_displacement_mm": None, "rms_after_mm": None}
        for reading in (*entry["markers"], *entry["effectors"]):
            reading |= dict.fromkeys(reading.keys() & {"simulated_mm", "simulated"})
    return entry


def solver_dict(model: Model) -> dict[str, Any]:
    """Name the solver, and what it solves: law, formulation and size of the mesh."""
    elasticity = getattr(model.law, "elasticity", None)  # not every law has one
    return {
        "name": model.solver.name,
        "law": type(model.law).__name__,
        "elasticity": elasticity and type(elasticity).__name__,
        "formulation": model.formulation,
        "element_order": model.mesh.order,
        **pick(model.mesh, "n_nodes n_tets"),
    }


def _point(result: InverseResult) -> dict[str, Any]:
    return {
        "configuration": result.configuration.name,
        **pick(result, "met tol"),
        "message": headline(result),
        "outcome": OUTCOMES[result.outcome],
        "goals": [_goal(fit, result.tol) for fit in result.goals],
        "actuators": [
            {"commanded": a.name in result.configuration.actuation, **plain(a)}
            for a in result.actuators
        ],
        **pick(result, "active_limits held_by blind"),
        "attempts": [
            {
                **pick(tried, "way error n_steps"),
                "outcome": None if tried.outcome is None else OUTCOMES[tried.outcome],
            }
            for tried in result.attempts
        ],
        "steps": result.steps,
    }


def _goal(fit: GoalFit, tol: float) -> dict[str, Any]:
    effector = fit.effector
    asked = lambda values: np.where(effector.seen, values, np.nan)
    return {
        **pick(effector, "name unit is_turn"),
        "met": bool(np.max(np.abs(fit.in_std), initial=0.0) <= tol),
        "goal": asked(effector.measured),
        "reached": fit.reached,
        "residual": asked(fit.residual),
        "std": effector.std,
        "in_std": asked(fit.in_std),
    }


def _design(result: DesignResult) -> dict[str, Any]:
    goal = "configuration name met error expected interval hangs_on share"
    return {
        **pick(result, "met values robust error expected"),
        "verdict": headline(result),
        "reasons": missed_words(result),
        "foam": None if result.foam is None else result.foam.infill,
        "commands": {
            c.name: {name: imposed.value for name, imposed in c.actuation.items()}
            for c in result.configurations
        },
        "goals": [pick(one, goal) for one in result.goals],
        "peaks": [vars(peak) for peak in result.peaks],
        "alternatives": {a.name: a.error for a in result.alternatives},
    }
