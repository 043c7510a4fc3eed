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
    HistoryEntry,
    ResidualChecks,
    SimulationResult,
)
from softcal_jax.configurations import EffectorRecord
from softcal_jax.equilibrium import Model, RobotState
from softcal_jax.export._budget import budget_dict
from softcal_jax.export._made import Made, made_dict, source_dict
from softcal_jax.export._plain import pick, plain, versions
from softcal_jax.identifiability import Assessment, Identifiability, Ranking, assess

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
    """Convert a calibration to the content of `result.json`.

    Keys: `format`, `name`, `converged`; `source`, the files that it was made from (see
    `source_dict`); `parameters` (`name`, `value`, `unit`,
    `standard_error` by all causes, `lower`, `upper`, `start`, `at_bound`, `interval`,
    null if none was asked for); `intervals`, the same as a list (`name`, `level`,
    `lower`, `upper`, `lower_end`, `upper_end`, `unit`, `kind`, `why`);
    `configurations` (`name`, `role`, `rms_before_mm`, `rms_after_mm`, `motion_mm`,
    `rms_after_percent_of_motion`, `markers` with `name`, `measured_mm`,
    `simulated_before_mm`, `simulated_mm`, `residual_mm`, other points included;
    `effectors` that are not points with `name`, `unit`, `is_turn`, `measured`,
    `simulated_before`, `simulated`, `residual`, turns from the measured orientation;
    `robot`, null if there is nothing in it: `rigid_bodies` (`name`, `state`,
    `position_mm`, `translation_mm`, `rotation_vector`), `actuators` (`name`, `kind`,
    `imposed`, `force`, `force_unit`, `displacement`, `displacement_unit`), `reactions`
    (`name`, `force` of the ground on the robot); then `newton_steps`, `residual`
    of the equilibrium, relative to its forces, `rounding` and `at_rounding`: what
    rounding leaves of it, and whether Newton stopped there, `min_det_F`);
    `history` (one entry per step, 0 is the start); `solver`; `settings`;
    `uncertainty` (covariance of the scaled parameters by the noise alone); `budget`
    (standard errors by cause, see `budget_dict`); `noise` (`jitter`: factor on the
    stated standard deviations of coordinates; `offset_mm`: offset of the recording of
    each configuration along each axis, `share`: share of its motion, both as standard
    deviations); `checks` (what residuals say, see `checks_dict`); `assessment`
    (`identified`; `reasons` why not; `misfit_probability` of residuals this large by
    chance, null where the noise was estimated; `predictions`: `name`, `role`, `std_mm`
    of the markers of each pose by the uncertainty of the parameters, null if that is
    unknown); `identifiability` (see `identifiability_dict`); `starts` (null for a
    single one; `names` of the parameters; `starts`, `values`, one row per run; `cost`,
    `steps`, `converged`; `optima`, the lowest cost first: `cost`, `values`, `starts`;
    `second_best`, likewise); `notes`; `versions`; `timing_s`.

    Args:
        result: The calibration.
        name: Its name.
        assessment: Its assessment, if known already.
        timing_s: Wall time of further parts, added to `result.timing_s` [s].
        directory: Folder that the file is for.
    """
    found = assessment or assess(result)
    runs = ("names", "starts", "values", "cost", "steps", "converged", "optima")
    runs += ("second_best",)
    return plain(
        {
            "format": RESULT_FORMAT,
            "name": name,
            "converged": result.converged,
            "source": source_dict(result.source, directory),
            "parameters": result.parameters,
            "intervals": result.intervals,
            "configurations": [_fit(fit) for fit in result.configurations],
            "history": [_step(entry) for entry in result.history],
            "solver": _solver(result.model),
            "settings": {
                "calibration": result.settings,
                "newton": result.newton,
                "noise": result.uncertainty.noise,
            },
            "uncertainty": _uncertainty(result),
            "budget": budget_dict(result.budget),
            "noise": _noise(result),
            "checks": checks_dict(result.checks),
            "assessment": {
                **pick(found, "identified", "reasons", "misfit_probability"),
                "predictions": [
                    {**pick(own, "name", "role"), "std_mm": 1e3 * own.std}
                    for own in found.predictions
                ],
            },
            "identifiability": identifiability_dict(found.identifiability),
            "starts": result.starts and pick(result.starts, *runs),
            "notes": result.notes,
            "versions": versions(result.model),
            "timing_s": {**result.timing_s, **(timing_s or {})},
        }
    )


def checks_dict(checks: ResidualChecks | None) -> dict[str, Any] | None:
    """Convert what the residuals say about a model to a dictionary.

    Keys: `reasons` why the model cannot be right, `agreement` of the recordings in
    words; `lack_of_fit` (null where the noise is stated; `ratio` of mean squares,
    `between`, `within`: degrees of freedom, `probability`, `jitter`, `shares` of the
    configurations); `left_out`, each configuration as the others predict it (`name`,
    `rms_mm`, `expected_mm` by noise, parameters and what is held fixed, `motion_mm`,
    `probability`, `by_scatter`); `recordings`, parameters from each recording alone
    (`recording`, `parameter`, `value`, `standard_error`, `fit`, `apart` in standard
    errors of the difference, `unit`, `probability`); `level` of the residuals over the
    stated std and its `probability` (null unless it was stated, and estimated).

    Args:
        checks: The checks; None for a result without them.
    """
    if checks is None:
        return None
    return plain(
        {
            **pick(checks, "reasons", "agreement", "lack_of_fit", "recordings"),
            **pick(checks, "level", "probability"),
            "left_out": [
                {
                    "name": own.name,
                    "rms_mm": 1e3 * own.rms,
                    "expected_mm": 1e3 * own.expected,
                    "motion_mm": 1e3 * own.motion,
                    **pick(own, "probability", "by_scatter"),
                }
                for own in checks.left_out
            ],
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

    Keys: `format`, `name`, `converged` (whether all did); `source`, `settings` and
    `versions` (see `made_dict`; without `made`, the first two say nothing);
    `configurations` (`name`,
    `converged`, `outcome`, `newton_steps`, `load_steps`, `residual`, `rounding`,
    `at_rounding`, `min_det_F`, `largest_displacement_mm`, `markers` and other points
    with `name`, `at_rest_mm`, `simulated_mm`, `effectors` that are not points with
    `name`, `unit`, `is_turn`, `simulated`, `robot` as in `result_dict`); `solver`;
    `timing_s` [s].
    Where there is no equilibrium, positions and displacement are null, and `outcome`
    says why.
    """
    return plain(
        {
            "format": "softcal_jax.simulation/1",
            "name": name,
            "converged": result.converged,
            **made_dict(made or Made(result.model, {}), directory),
            "configurations": [_simulated(c) for c in result.configurations],
            "solver": _solver(result.model),
            "timing_s": timing_s or {},
        }
    )


def identifiability_dict(found: Identifiability) -> dict[str, Any]:
    """Convert an identifiability result to a dictionary.

    Keys: `verdict`, `n_data`, `precision` that is asked for; `parameters` (`name`,
    `value`, `unit`, `standard_error`, `data_only`, `prior` if stated, `asked`,
    `relative`, `ratio` of standard error and asked one, `verdict`); `informed`, the
    number of directions along which the data tell more than the prior; `directions`,
    the best seen first (`words`, `ratio`, `verdict`, `components` in units of the asked
    errors, in the order of the parameters); `covariance` (of the scaled parameters) and
    `correlation`; `conditioning` (`singular_values`, `condition_...`); `unknown`,
    causes of errors that are left out since their size is not known. Null stands for
    an infinite condition number, and for whatever is unknown of a parameter or a
    direction to which data and priors are blind.
    """
    names = "verdict n_data precision parameters informed directions covariance"
    names += " correlation conditioning unknown"
    return plain(pick(found, *names.split()))


def outlook_dict(
    found: Identifiability | None,
    ranking: Ranking | None,
    *,
    name: str = "identifiability",
    timing_s: Mapping[str, float] | None = None,
    made: Made | None = None,
    directory: str | Path = ".",
) -> dict[str, Any]:
    """Build the content of `identifiability.json`.

    Keys: `format`, `name`; `source`, `settings` and `versions` (see `made_dict`);
    `identifiability` (see `identifiability_dict`; null without
    configurations); `ranking` (null without candidates): `blind_before`, `candidates`,
    the best first (`name`, `d_gain`, `e_gain`, `volume`, `blind_left`, and for the
    standard error that falls most `parameter`, `before`, `after`, `value`, `unit`),
    `unranked` (`name`, `reason`); `timing_s` [s].
    """
    ranked = ranking and {
        "blind_before": ranking.blind_before,
        "candidates": [{**plain(g), "volume": g.volume} for g in ranking.gains],
        "unranked": ranking.unranked,
    }
    return plain(
        {
            "format": "softcal_jax.identifiability/2",
            "name": name,
            **made_dict(made, directory),
            "identifiability": found and identifiability_dict(found),
            "ranking": ranked,
            "timing_s": timing_s or {},
        }
    )


def _fit(fit: ConfigurationResult) -> dict[str, Any]:
    return {
        **pick(fit, "name", "role"),
        "rms_before_mm": 1e3 * fit.rms_before,
        "rms_after_mm": 1e3 * fit.rms_after,
        "motion_mm": 1e3 * fit.motion,
        "rms_after_percent_of_motion": 100.0 * fit.rms_share,
        **_effectors(fit, "measured", "simulated_before", "simulated", "residual"),
        "robot": _robot(fit.robot),
        **pick(fit, "newton_steps", "residual", "rounding", "at_rounding", "min_det_F"),
    }


def _simulated(result: ConfigurationResult) -> dict[str, Any]:
    largest = 1e3 * result.largest_displacement if result.converged else None
    return {
        **pick(result, "name", "converged", "outcome"),
        **pick(result, "newton_steps", "load_steps", "residual", "rounding"),
        **pick(result, "at_rounding", "min_det_F"),
        "largest_displacement_mm": largest,
        **_effectors(result, "at_rest", "simulated"),
        "robot": _robot(result.robot),
    }


def _effectors(result: ConfigurationResult, *columns: str) -> dict[str, Any]:
    """Convert markers and other points in mm, then the other effectors in SI."""

    def values(effector: EffectorRecord, column: str, factor: float = 1.0):
        nowhere = column == "simulated" and not result.converged
        return None if nowhere else factor * getattr(effector, column)

    return {
        "markers": [
            {"name": point.name, **{f"{c}_mm": values(point, c, 1e3) for c in columns}}
            for point in result.points
        ],
        "effectors": [
            {
                **pick(effector, "name", "unit", "is_turn"),
                **{c: values(effector, c) for c in columns if c != "at_rest"},
            }
            for effector in result.others
        ],
    }


def _robot(state: RobotState | None) -> dict[str, Any] | None:
    """Convert rigid bodies, actuators and reactions."""
    return state and {
        "rigid_bodies": [
            {
                **pick(body, "name", "state"),
                "position_mm": 1e3 * body.position,
                "translation_mm": 1e3 * body.translation,
                "rotation_vector": body.rotation_vector,
            }
            for body in state.bodies
        ],
        **pick(state, "actuators", "reactions"),
    }


def _step(entry: HistoryEntry) -> dict[str, Any]:
    step = plain(entry)
    del step["rms"]
    return {**step, "rms_mm": 1e3 * entry.rms}


def _solver(model: Model) -> dict[str, Any]:
    elasticity = getattr(model.law, "elasticity", None)  # not every law has one
    return {
        "name": model.solver.name,
        "law": type(model.law).__name__,
        "elasticity": elasticity and type(elasticity).__name__,
        "formulation": model.formulation,
        "element_order": model.mesh.order,
        **pick(model.mesh, "n_nodes", "n_tets"),
    }


def _noise(result: CalibrationResult) -> dict[str, Any] | None:
    """Convert the noise that weighed the data."""
    noise = result.noise
    if noise is None:
        return None
    offset_mm = 1e3 * np.asarray(noise.offset)
    return {**pick(noise, "jitter", "share"), "offset_mm": offset_mm}


def _uncertainty(result: CalibrationResult) -> dict[str, Any]:
    names = "noise noise_scale degrees_of_freedom chi_squared covariance correlation"
    with np.errstate(invalid="ignore", divide="ignore"):  # an exact fit has no spread
        return pick(result.uncertainty, *names.split())
