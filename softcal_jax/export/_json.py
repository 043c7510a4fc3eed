"""Results as dictionaries for JSON: positions in mm, the rest in SI."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np

from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    SimulationResult,
)
from softcal_jax.configurations import EffectorRecord
from softcal_jax.equilibrium import Model, RobotState
from softcal_jax.export._budget import budget_dict
from softcal_jax.export._identifiability import (
    assessment_dict,
    identifiability_dict,
    starts_dict,
)
from softcal_jax.export._plain import fields_of, plain
from softcal_jax.export._versions import versions
from softcal_jax.identifiability import Assessment, assess


def result_dict(
    result: CalibrationResult,
    *,
    name: str = "calibration",
    assessment: Assessment | None = None,
    timing_s: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Convert a calibration to the content of `result.json`.

    Keys: `format`, `name`, `converged`; `parameters` (`name`, `value`, `unit`,
    `standard_error` by all causes, `lower`, `upper`, `start`, `at_bound`; SI);
    `intervals` (`name`, `level`, `lower`, `upper`, `lower_end`, `upper_end`, `unit`;
    SI); `configurations` (`name`, `role`, `rms_before_mm`, `rms_after_mm`, `motion_mm`,
    `rms_after_percent_of_motion`, `markers` with `name`, `measured_mm`,
    `simulated_before_mm`, `simulated_mm`, `residual_mm`, other points included;
    `effectors` that are not points with `name`, `unit`, `is_turn`, `measured`,
    `simulated_before`, `simulated`, `residual`, in SI, turns from the measured
    orientation; `robot`: rigid bodies, actuators and reactions, see `robot_dict`, null
    if there are none; then `newton_steps`, `residual`, `min_det_F`); `history` (one
    entry per step, 0 is the start); `solver`; `settings`; `uncertainty` (covariance of
    the scaled parameters by the noise alone); `budget` (standard errors by cause, see
    `budget_dict`); `assessment` (see `assessment_dict`); `identifiability` (see
    `identifiability_dict`); `starts` (see `starts_dict`; null for a single start);
    `notes`; `versions`; `timing_s`. Missing numbers are null.

    Args:
        result: The calibration.
        name: Its name.
        assessment: Its assessment, if known already.
        timing_s: Wall time of further parts, added to `result.timing_s` [s].

    Returns:
        Dictionaries, lists, texts, numbers and None; no NaN and no infinity.
    """
    found = assessment or assess(result)
    return plain(
        {
            "format": "softcal_jax.result/2",
            "name": name,
            "converged": result.converged,
            "parameters": [fields_of(parameter) for parameter in result.parameters],
            "intervals": [fields_of(interval) for interval in result.intervals],
            "configurations": [_fit(fit) for fit in result.configurations],
            "history": [_step(entry) for entry in result.history],
            "solver": _solver(result.model),
            "settings": {
                "calibration": fields_of(result.settings),
                "newton": fields_of(result.newton),
                "noise": result.uncertainty.noise,
            },
            "uncertainty": _uncertainty(result),
            "budget": budget_dict(result.budget),
            "assessment": assessment_dict(found),
            "identifiability": identifiability_dict(found.identifiability),
            "starts": result.starts and starts_dict(result.starts),
            "notes": list(result.notes),
            "versions": versions(result.model),
            "timing_s": {**result.timing_s, **(timing_s or {})},
        }
    )


def simulation_dict(
    result: SimulationResult,
    *,
    name: str = "simulation",
    timing_s: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Convert a forward simulation to the content of `simulation.json`.

    Keys: `format`, `name`, `converged` (whether all did); `configurations` (`name`,
    `converged`, `outcome`, `newton_steps`, `load_steps`, `residual`, `min_det_F`,
    `largest_displacement_mm`, `markers` and other points with `name`, `at_rest_mm`,
    `simulated_mm`, `effectors` that are not points with `name`, `unit`, `is_turn`,
    `simulated`, `robot` as in `result_dict`); `solver`; `versions`;
    `timing_s`. Where there is no equilibrium, positions and displacement are null, and
    `outcome` says why.

    Args:
        result: The simulation.
        name: Its name.
        timing_s: Wall time per part [s].

    Returns:
        Dictionaries, lists, texts, numbers and None; no NaN and no infinity.
    """
    return plain(
        {
            "format": "softcal_jax.simulation/1",
            "name": name,
            "converged": result.converged,
            "configurations": [_simulated(c) for c in result.configurations],
            "solver": _solver(result.model),
            "versions": versions(result.model),
            "timing_s": dict(timing_s or {}),
        }
    )


def _fit(fit: ConfigurationResult) -> dict[str, Any]:
    return {
        "name": fit.name,
        "role": fit.role,
        "rms_before_mm": 1e3 * fit.rms_before,
        "rms_after_mm": 1e3 * fit.rms_after,
        "motion_mm": 1e3 * fit.motion,
        "rms_after_percent_of_motion": 100.0 * fit.rms_share,
        **_effectors(fit, "measured", "simulated_before", "simulated", "residual"),
        "robot": robot_dict(fit.robot),
        "newton_steps": fit.newton_steps,
        "residual": fit.residual,
        "min_det_F": fit.min_det_F,
    }


def _simulated(result: ConfigurationResult) -> dict[str, Any]:
    largest = 1e3 * result.largest_displacement if result.converged else None
    return {
        "name": result.name,
        "converged": result.converged,
        "outcome": result.outcome,
        "newton_steps": result.newton_steps,
        "load_steps": result.load_steps,
        "residual": result.residual,
        "min_det_F": result.min_det_F,
        "largest_displacement_mm": largest,
        **_effectors(result, "at_rest", "simulated"),
        "robot": robot_dict(result.robot),
    }


def _effectors(result: ConfigurationResult, *columns: str) -> dict[str, Any]:
    """Convert markers and other points in mm, then the other effectors in SI."""

    def values(effector: EffectorRecord, column: str, factor: float = 1.0):
        nowhere = column == "simulated" and not result.converged
        return None if nowhere else factor * getattr(effector, column)

    return {
        "markers": [
            {
                "name": point.name,
                **{f"{column}_mm": values(point, column, 1e3) for column in columns},
            }
            for point in result.points
        ],
        "effectors": [
            {
                "name": effector.name,
                "unit": effector.unit,
                "is_turn": effector.is_turn,
                **{c: values(effector, c) for c in columns if c != "at_rest"},
            }
            for effector in result.others
        ],
    }


def robot_dict(state: RobotState | None) -> dict[str, Any] | None:
    """Convert rigid bodies, actuators and reactions; positions in mm, the rest in SI.

    Keys: `rigid_bodies` (`name`, `state`, `position_mm`, `translation_mm`,
    `rotation_vector`), `actuators` (`name`, `kind`, `imposed`, `force`, `force_unit`,
    `displacement`, `displacement_unit`), `reactions` (`name`, `force` of the ground on
    the robot).

    Args:
        state: Their state; None if there are none.
    """
    if state is None:
        return None
    return {
        "rigid_bodies": [
            {
                "name": body.name,
                "state": body.state,
                "position_mm": 1e3 * body.position,
                "translation_mm": 1e3 * body.translation,
                "rotation_vector": body.rotation_vector,
            }
            for body in state.bodies
        ],
        "actuators": [fields_of(actuator) for actuator in state.actuators],
        "reactions": [fields_of(reaction) for reaction in state.reactions],
    }


def _step(entry: eqx.Module) -> dict[str, Any]:
    step = fields_of(entry)
    step["rms_mm"] = 1e3 * step.pop("rms")
    return step


def _solver(model: Model) -> dict[str, Any]:
    elasticity = getattr(model.law, "elasticity", None)  # not every law has one
    return {
        "name": model.solver.name,
        "law": type(model.law).__name__,
        "elasticity": elasticity and type(elasticity).__name__,
        "formulation": model.formulation,
        "element_order": model.mesh.order,
        "n_nodes": model.mesh.n_nodes,
        "n_tets": model.mesh.n_tets,
    }


def _uncertainty(result: CalibrationResult) -> dict[str, Any]:
    spread = result.uncertainty
    with np.errstate(invalid="ignore", divide="ignore"):  # an exact fit has no spread
        correlation = spread.correlation
    return {
        "noise": spread.noise,
        "noise_scale": spread.noise_scale,
        "degrees_of_freedom": spread.degrees_of_freedom,
        "chi_squared": spread.chi_squared,
        "covariance": spread.covariance,
        "correlation": correlation,
    }
