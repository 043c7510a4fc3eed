"""Results as dictionaries that JSON can hold: markers in mm, the rest in SI."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import CalibrationResult, ConfigurationFit
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import (
    RESULTS,
    EquilibriumSolution,
    Model,
    RobotState,
    robot_states,
)
from softcal_jax.export._identifiability import (
    assessment_dict,
    identifiability_dict,
    starts_dict,
)
from softcal_jax.export._plain import fields_of, plain
from softcal_jax.export._robot import robot_dict, simulated_effectors
from softcal_jax.export._versions import versions
from softcal_jax.identifiability import assess


def result_dict(
    result: CalibrationResult,
    *,
    name: str = "calibration",
    timing_s: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """A calibration as a dictionary, the content of `result.json`.

    Keys: `format`, `name`, `converged`; `parameters` (`name`, `value`, `unit`,
    `standard_error`, `lower`, `upper`, `start`, `at_bound`; SI); `intervals` (`name`,
    `level`, `lower`, `upper`, `lower_end`, `upper_end`, `unit`; SI); `configurations`
    (`name`, `role`, `rms_before_mm`, `rms_after_mm`, `motion_mm`,
    `rms_after_percent_of_motion`, `markers` with `name`, `measured_mm`,
    `simulated_before_mm`, `simulated_mm`, `residual_mm`, and points of other effectors;
    `effectors` that are no points with `name`, `unit`, `is_turn`, `measured`,
    `simulated_before`, `simulated`, `residual`, in SI, turns from the measured
    orientation; `robot`: rigid bodies, actuators and reactions, see `robot_dict`, null
    for a body that has none; then `newton_steps`, `residual`, `min_det_F`);
    `history` (one entry per step, 0 is the start); `solver`; `settings`; `uncertainty`
    (covariance of the scaled parameters); `assessment` (see `assessment_dict`);
    `identifiability` (see `identifiability_dict`); `starts` (see
    `starts_dict`; null if there was one); `notes`; `versions`; `timing_s`. A number
    that does not exist is null.

    Args:
        result: The calibration.
        name: Its name.
        timing_s: Wall time of more parts, added to `result.timing_s` [s].

    Returns:
        Dictionaries, lists, texts, numbers and None; no NaN and no infinity.
    """
    found = assess(result)
    return plain(
        {
            "format": "softcal_jax.result/1",
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
            "assessment": assessment_dict(found),
            "identifiability": identifiability_dict(found.identifiability),
            "starts": result.starts and starts_dict(result.starts),
            "notes": list(result.notes),
            "versions": versions(result.model),
            "timing_s": {**result.timing_s, **(timing_s or {})},
        }
    )


def simulation_dict(
    model: Model,
    configurations: Sequence[Configuration],
    solution: EquilibriumSolution,
    *,
    name: str = "simulation",
    timing_s: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """A forward simulation as a dictionary, the content of `simulation.json`.

    Keys: `format`, `name`, `converged` (all of them); `configurations` (`name`,
    `converged`, `outcome`, `newton_steps`, `load_steps`, `residual`, `min_det_F`,
    `largest_displacement_mm`, `markers` and points of other effectors with `name`,
    `at_rest_mm`, `simulated_mm`, `effectors` that are no points with `name`, `unit`,
    `is_turn`, `simulated`, `robot` as `result_dict` has it); `solver`; `versions`;
    `timing_s`. Where there is no equilibrium, positions and displacement are null, and
    `outcome` says why.

    Args:
        model: The body.
        configurations: What was simulated.
        solution: Their equilibria, one lane per configuration.
        name: Name of the simulation.
        timing_s: Wall time per part [s].

    Returns:
        Dictionaries, lists, texts, numbers and None; no NaN and no infinity.
    """
    states = robot_states(model, configurations, solution)
    effectors = simulated_effectors(model, configurations, solution)
    lanes = [
        _lane(
            configuration,
            jax.tree.map(lambda leaf, i=i: leaf[i], solution),
            np.asarray(solution.displacement[i])[: model.mesh.n_nodes],
            *effectors[i],
            states[i],
        )
        for i, configuration in enumerate(configurations)
    ]
    return plain(
        {
            "format": "softcal_jax.simulation/1",
            "name": name,
            "converged": all(lane["converged"] for lane in lanes),
            "configurations": lanes,
            "solver": _solver(model),
            "versions": versions(model),
            "timing_s": dict(timing_s or {}),
        }
    )


def _fit(fit: ConfigurationFit) -> dict[str, Any]:
    motion = fit.motion
    measured = np.where(fit.seen, fit.measured, np.nan)
    residual = np.where(fit.seen, fit.error_after, np.nan)
    return {
        "name": fit.name,
        "role": fit.role,
        "rms_before_mm": 1e3 * fit.rms_before,
        "rms_after_mm": 1e3 * fit.rms_after,
        "motion_mm": 1e3 * motion,
        "rms_after_percent_of_motion": (
            100.0 * fit.rms_after / motion if motion > 0.0 else None
        ),
        "markers": [
            {
                "name": marker,
                "measured_mm": 1e3 * measured[i],
                "simulated_before_mm": 1e3 * fit.before[i],
                "simulated_mm": 1e3 * fit.after[i],
                "residual_mm": 1e3 * residual[i],
            }
            for i, marker in enumerate(fit.marker_names)
        ],
        "effectors": [
            {
                "name": effector.name,
                "unit": effector.unit,
                "is_turn": effector.is_turn,
                "measured": effector.measured,
                "simulated_before": effector.before,
                "simulated": effector.after,
                "residual": effector.error_after,
            }
            for effector in fit.others
        ],
        "robot": robot_dict(fit.robot),
        "newton_steps": fit.newton_steps,
        "residual": fit.residual,
        "min_det_F": fit.min_det_F,
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


def _lane(
    configuration: Configuration,
    solution: EquilibriumSolution,
    u: Float[HostArray, "n_nodes 3"],
    points: list[dict[str, Any]],
    others: list[dict[str, Any]],
    robot: RobotState | None,
) -> dict[str, Any]:
    ok = bool(solution.converged)
    return {
        "name": configuration.name,
        "converged": ok,
        "outcome": RESULTS[solution.result],
        "newton_steps": int(solution.steps),
        "load_steps": int(solution.load_steps),
        "residual": float(solution.residual),
        "min_det_F": float(solution.min_det_F),
        "largest_displacement_mm": (
            1e3 * float(np.linalg.norm(u, axis=1).max()) if ok else None
        ),
        "markers": points,
        "effectors": others,
        "robot": robot_dict(robot),
    }
