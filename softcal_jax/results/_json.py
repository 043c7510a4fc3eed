"""Results as dictionaries for JSON: positions in mm, the rest in SI, angles in rad.

`KEYS` says what is written of each class. They hold dictionaries, lists, texts, numbers
and None, which stands for every number that is missing or not finite.
"""

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import jax
import numpy as np

from softcal_jax._module import Result
from softcal_jax._units import QUANTITIES
from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    HistoryEntry,
    LeftOut,
    MultiStartResult,
    ResidualChecks,
    SimulationResult,
)
from softcal_jax.configurations import EffectorRecord
from softcal_jax.contact import ContactState
from softcal_jax.control import OUTCOMES, InverseResult, TrajectoryResult
from softcal_jax.designs import DesignResult
from softcal_jax.equilibrium import BodyPlace, Model, RobotState
from softcal_jax.identifiability import (
    Assessment,
    Identifiability,
    Prediction,
    Ranking,
    assess,
)
from softcal_jax.inference import ErrorBudget, Uncertainty
from softcal_jax.layouts import (
    LEVEL_OF_COMPARISON,
    FoldScore,
    ModelComparison,
    ModelScore,
    PairedDifference,
)
from softcal_jax.results._goals import design_bodies, missed_words
from softcal_jax.results._made import Made, made_dict
from softcal_jax.results._sections import RESULT_KINDS, Transfer, headline
from softcal_jax.unknowns import CorrelatedNoise

KEYS: dict[type | str, str] = {
    "markers": "name measured_mm simulated_before_mm simulated_mm residual_mm",
    "effectors": "name unit is_turn measured simulated_before simulated residual",
    CalibrationResult: "converged parameters intervals configurations history "
    "uncertainty noise checks starts mistakes notes",
    ConfigurationResult: "name role rms_before_mm rms_after_mm motion_mm "
    "rms_after_percent_of_motion=rms_share markers=points effectors=others robot "
    "newton_steps residual rounding at_rounding min_det_F",
    HistoryEntry: "step cost lambda_p step_bound accepted kkt_residual newton_steps "
    "values noise_level seconds rms_mm",
    Uncertainty: "noise noise_scale degrees_of_freedom chi_squared covariance "
    "correlation",
    CorrelatedNoise: "jitter share offset_mm",
    ResidualChecks: "reasons agreement lack_of_fit recordings level probability "
    "left_out",
    LeftOut: "name rms_mm expected_mm motion_mm probability by_scatter",
    MultiStartResult: "names starts values cost steps converged optima second_best "
    "missed",
    Assessment: "outcome contradicted reasons misfit_probability predictions held",
    Prediction: "name role std_mm",
    Identifiability: "verdict n_data precision parameters informed directions "
    "covariance correlation conditioning",
    RobotState: "rigid_bodies=bodies actuators reactions contacts",
    ContactState: "name force moment area depth sliding",
    BodyPlace: "name state position_mm translation_mm rotation_vector",
    ModelScore: "name n_parameters held_out_rms_mm held_out_noise_rms score fit_rms_mm "
    "fit_noise_rms fit_failure verdict folds",
    FoldScore: "held_out rms_mm noise_rms fit_rms_mm failure",
    Transfer: "difference poses motion rms_own rms_of_a lost "
    "probability=difference.probability agree=difference.agree",
    PairedDifference: "name difference standard_error half_width n told_apart",
}
"""Keys of the classes that results are made of, by attributes; of others, all fields.

Effectors have those of `markers` where they are points, else those of `effectors`.

One in _mm is converted from metres, one in percent from a share; `key=attribute` gives
an attribute another name.
"""


def plain(value: Any) -> Any:
    """Convert records to dictionaries, arrays to lists, non-finite numbers to None.

    Keys of records are `KEYS`, or else all fields. NumPy numbers become Python's.
    """
    if isinstance(value, EffectorRecord):
        kind = "markers" if value.quantity == "point" else "effectors"
        return plain(pick(value, KEYS[kind]))
    if dataclasses.is_dataclass(value):
        every = " ".join(field.name for field in dataclasses.fields(value))
        value = pick(value, KEYS.get(type(value), every))
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        value = np.asarray(value).tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def pick(owner: object, names: str) -> dict[str, Any]:
    """Return some attributes, by keys like those of `KEYS`."""
    picked = {}
    for name in names.split():
        key, _, attribute = name.partition("=")
        value = attrgetter(attribute or key.removesuffix("_mm"))(owner)
        factor = _factor(key)
        picked[key] = value if factor == 1.0 else factor * np.asarray(value)
    return picked


def _factor(key: str) -> float:
    """Return the factor from SI to the unit that the end of a key names."""
    ends = {"_mm": "distance", "_percent_of_motion": "share"}
    quantities = (QUANTITIES[of] for end, of in ends.items() if key.endswith(end))
    return next((factor for _, factor, _ in quantities), 1.0)


def read_column(entries: Sequence[Mapping[str, Any]], key: str) -> dict[str, Any]:
    """Return what entries of a file have under a key, by their names, in SI.

    A number that `plain` left out is nan.
    """
    factor = _factor(key)
    read = lambda value: math.nan if value is None else value / factor
    return {e["name"]: e[key] if factor == 1.0 else read(e[key]) for e in entries}


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write a dictionary, as from `result_dict`, as JSON that every parser reads.

    Raises:
        ValueError: If it holds a NaN or an infinity, which JSON lacks.
    """
    text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


RESULT_FORMAT = f"softcal_jax.{RESULT_KINDS[CalibrationResult].format}"
"""Format of `result.json`."""


def result_dict(
    result: Result,
    known: Assessment | Ranking | None = None,
    *,
    name: str = "",
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
        known: What is known of it besides, see `sections`.
        name: Its name; by default its kind.
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
            assessment = known if isinstance(known, Assessment) else assess(result)
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
            content, made = _simulation(result), made or Made(result.model, {})
        case DesignResult():
            content = {**_simulation(design_bodies(result)), "design": _design(result)}
        case InverseResult() | TrajectoryResult():
            points = [result] if isinstance(result, InverseResult) else result.points
            met = all(point.met for point in points)
            content = {"met": met, "points": [*map(_point, points)]}
            made = made or Made(points[0].model, {})
        case ModelComparison():
            made = made or {}
            content = {
                "verdict": headline(result),
                **pick(result, "undecided models differences"),
                "best": result.best and result.best.name,
                "level": LEVEL_OF_COMPARISON,
            }
        case Identifiability() | Ranking():
            content = _outlook(result, known)
        case _:
            raise TypeError(f"a {type(result).__name__} is no result that is written.")
    kind = RESULT_KINDS[type(result)]
    return plain(
        {
            "format": f"softcal_jax.{kind.format}",
            "name": name or kind.file.replace("result", "calibration"),
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


def _outlook(result: Identifiability | Ranking, known: Any) -> dict[str, Any]:
    outlook, ranked = (None, result) if isinstance(result, Ranking) else (result, known)
    budget = outlook and outlook.budget and _budget(outlook.budget)
    left = ranked.unranked.items() if ranked else ()
    said = ranked and {
        "candidates": ranked.gains,
        "reached": ranked.reached,
        "unranked": [{"name": name, "reason": reason} for name, reason in left],
    }
    return {"identifiability": outlook, "budget": budget, "ranking": said}


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
        "goals": [
            {
                **pick(goal, "name unit is_turn"),
                "met": goal.worst <= result.tol,
                **pick(goal, "goal=measured reached=simulated residual std in_std"),
            }
            for goal in result.goals
        ],
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


def _design(result: DesignResult) -> dict[str, Any]:
    goal = "configuration name=effector.name met error expected interval hangs_on share"
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
