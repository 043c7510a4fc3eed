"""Results as dictionaries for JSON: positions in mm, the rest in SI, angles in rad.

They hold dictionaries, lists, texts, numbers and None, which stands for every number
that is missing or not finite.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    SimulationResult,
)
from softcal_jax.control import OUTCOMES, GoalFit, InverseResult, TrajectoryResult
from softcal_jax.equilibrium import Model
from softcal_jax.export._made import Made, made_dict, pick, plain, source_dict, versions
from softcal_jax.identifiability import Assessment, Identifiability, Ranking, assess
from softcal_jax.inference import ErrorBudget
from softcal_jax.layouts import LEVEL_OF_COMPARISON, ModelComparison

RESULT_FORMAT = "softcal_jax.result/2"
"""Format of `result.json`."""


def result_dict(
    result: CalibrationResult,
    *,
    name: str = "calibration",
    assessment: Assessment | None = None,
    timing_s: Mapping[str, float] | None = None,
    directory: str | Path = ".",
) -> dict[str, Any]:
    """Convert a calibration to `result.json`, see `result_file.ResultFile`.

    Its assessment is made if it is not given; `timing_s` are wall times of further
    parts [s], and paths of files are relative to `directory`.
    """
    # Imported here, as pydantic takes a third of a second to load, often for nothing.
    from softcal_jax.export.result_file import ResultFile

    assessment = assessment or assess(result)
    content = {
        "format": RESULT_FORMAT,
        "name": name,
        "converged": bool(result.converged),
        "source": source_dict(result.source, directory),
        **pick(result, "parameters intervals configurations history"),
        "solver": solver_dict(result.model),
        "settings": {
            "calibration": result.settings,
            "newton": result.newton,
            "noise": result.uncertainty.noise,
        },
        **pick(result, "uncertainty noise checks starts mistakes notes"),
        "budget": budget_dict(result.budget),
        "assessment": assessment,
        "identifiability": assessment.identifiability,
        "versions": versions(result.model),
        "timing_s": {**result.timing_s, **(timing_s or {})},
    }
    with np.errstate(invalid="ignore", divide="ignore"):  # an exact fit has no spread
        file = ResultFile.model_validate(content)
    return file.model_dump(exclude_unset=True)


def budget_dict(budget: ErrorBudget) -> dict[str, Any]:
    """Convert an error budget to a dictionary, see `result_file.BudgetEntry`."""
    by_cause, total = budget.by_cause(), budget.standard_errors
    return plain(
        {
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
    )


def simulation_dict(
    result: SimulationResult,
    *,
    name: str = "simulation",
    timing_s: Mapping[str, float] | None = None,
    made: Made | None = None,
    directory: str | Path = ".",
) -> dict[str, Any]:
    """Convert a forward simulation to the content of `simulation.json`.

    Keys of `configurations` are attributes of `ConfigurationResult`, with points as
    `markers`, other readings as `effectors` and `robot` as `RobotEntry`. Where there is
    no equilibrium, positions and displacement are null, and `outcome` says why. Those
    that were measured say how far they are off.
    """
    return plain(
        {
            "format": "softcal_jax.simulation/1",
            "name": name,
            "converged": result.converged,
            **made_dict(made or Made(result.model, {}), directory),
            "configurations": [_simulated(c) for c in result.configurations],
            "doubts": result.doubts,
            "solver": solver_dict(result.model),
            "timing_s": timing_s or {},
        }
    )


def outlook_dict(
    outlook: Identifiability | None,
    ranking: Ranking | None,
    *,
    name: str = "identifiability",
    timing_s: Mapping[str, float] | None = None,
    made: Made | None = None,
    directory: str | Path = ".",
) -> dict[str, Any]:
    """Build the content of `identifiability.json`.

    `identifiability` is as in `result.json`, null without configurations; `ranking` is
    null without candidates. Candidates have the attributes of `Gain`, the best first.
    """
    from softcal_jax.export.result_file import IDENTIFIABILITY

    ranked = ranking and {
        "candidates": ranking.gains,
        "reached": ranking.reached,
        "unranked": ranking.unranked,
    }
    return plain(
        {
            "format": "softcal_jax.identifiability/3",
            "name": name,
            **made_dict(made, directory),
            "identifiability": outlook and IDENTIFIABILITY.entry(outlook),
            "budget": outlook and outlook.budget and budget_dict(outlook.budget),
            "ranking": ranked,
            "timing_s": timing_s or {},
        }
    )


def _simulated(result: ConfigurationResult) -> dict[str, Any]:
    from softcal_jax.export.result_file import RobotEntry

    entry = pick(
        result,
        "name role converged outcome newton_steps load_steps residual rounding "
        "at_rounding min_det_F largest_displacement_mm rms_after_mm motion_mm",
    )
    point = "name at_rest_mm measured_mm simulated_mm"
    entry["markers"] = [pick(p, point) for p in result.points]
    other = "name unit is_turn measured simulated"
    entry["effectors"] = [pick(e, other) for e in result.others]
    entry["robot"] = None
    if result.robot is not None:
        entry["robot"] = RobotEntry.model_validate(result.robot).model_dump()
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


def comparison_dict(
    comparison: ModelComparison,
    *,
    name: str = "comparison",
    timing_s: Mapping[str, float] | None = None,
    made: Mapping[str, Made] | None = None,
    directory: str | Path = ".",
) -> dict[str, Any]:
    """Build the content of `comparison.json`.

    `models`, the best first, their `folds` and the `differences` from the first have
    attributes of `ModelScore`, `FoldScore` and `PairedDifference`, lengths in mm (_mm);
    scores and differences are squares in units of the noise. `best` is null if no model
    predicts everything. `sources` and `settings` are by model, in the order of `made`.
    """
    by_model = {model: made_dict(of, directory) for model, of in (made or {}).items()}
    best = comparison.best
    scored = (
        "name n_parameters held_out_rms_mm held_out_noise_rms score fit_rms_mm "
        "fit_noise_rms fit_failure verdict"
    )
    fold = "held_out rms_mm noise_rms fit_rms_mm failure"
    return plain(
        {
            "format": "softcal_jax.comparison/1",
            "name": name,
            "sources": {model: of["source"] for model, of in by_model.items()},
            "settings": {model: of["settings"] for model, of in by_model.items()},
            "versions": {
                k: v for of in by_model.values() for k, v in of["versions"].items()
            },
            "verdict": comparison.verdict,
            "best": best and best.name,
            "undecided": comparison.undecided,
            "level": LEVEL_OF_COMPARISON,
            "models": [
                {**pick(m, scored), "folds": [pick(one, fold) for one in m.folds]}
                for m in comparison.models
            ],
            "differences": [
                pick(d, "name difference standard_error half_width n told_apart")
                for d in comparison.differences
            ],
            "timing_s": timing_s or {},
        }
    )


def inverse_dict(
    result: InverseResult | TrajectoryResult,
    *,
    name: str = "inverse",
    timing_s: Mapping[str, float] | None = None,
    made: Made | None = None,
    directory: str | Path = ".",
) -> dict[str, Any]:
    """Build the content of `inverse.json`, in SI and radians.

    `points` has one entry for each goal of a trajectory, else one, with the attributes
    of `InverseResult`. In `goals`, `in_std` is residual over std, a coordinate without
    a goal has null, and turns are counted from the goal; `actuators` have the
    attributes of `ActuatorState` and whether they are `commanded`.
    """
    points = [result] if isinstance(result, InverseResult) else result.points
    return plain(
        {
            "format": "softcal_jax.inverse/1",
            "name": name,
            "met": all(point.met for point in points),
            **made_dict(made or Made(points[0].model, {}), directory),
            "points": [_point(point) for point in points],
            "timing_s": timing_s or {},
        }
    )


def _point(result: InverseResult) -> dict[str, Any]:
    return {
        "configuration": result.configuration.name,
        **pick(result, "met message tol"),
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
