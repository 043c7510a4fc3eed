"""Calibrate the finite-element model of a soft robot from a few measured poses.

This module offers what a notebook needs. The rest is in the packages, which follow the
method step by step: `mesh`, `materials`, `fields`, `bodies`, `actuators`,
`configurations`, `equilibrium`, `sensitivity`, `calibration`, `identifiability`,
`control`, `layouts`.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from softcal_jax._compilation_cache import use_compilation_cache
    from softcal_jax.actuators import Cable, Chamber, Guide, Motor
    from softcal_jax.bodies import Pose, RigidBody
    from softcal_jax.calibration import (
        calibrate,
        profile_intervals,
        simulated_measurements,
        synthetic_measurements,
    )
    from softcal_jax.configurations import (
        ActuatorDisplacement,
        BodyFrame,
        Configuration,
        EdgeForce,
        ImposedDisplacement,
        ImposedForce,
        Markers,
        Support,
        read_markers,
        read_poses,
        register,
    )
    from softcal_jax.control import solve_inverse
    from softcal_jax.equilibrium import build_model, solve_equilibrium
    from softcal_jax.exchange.icesl import export_icesl
    from softcal_jax.exchange.inp import export_inp
    from softcal_jax.exchange.sofa import export_sofa
    from softcal_jax.fields import (
        ControlPointParameters,
        ControlPoints,
        Parameter,
        ParameterSpace,
    )
    from softcal_jax.identifiability import assess, identify, rank_configurations
    from softcal_jax.layouts import compare_laws
    from softcal_jax.materials import (
        Corotational,
        Fibre,
        Isotropic,
        NeoHookean,
        ReducedTransverseIsotropic,
    )
    from softcal_jax.mesh import beam, read_mesh, select_nodes
    from softcal_jax.project import load_project
    from softcal_jax.report import (
        load_result,
        write_results,
    )

__version__ = version("softcal-jax")

_HOMES = {
    "ActuatorDisplacement": "softcal_jax.configurations",
    "BodyFrame": "softcal_jax.configurations",
    "Cable": "softcal_jax.actuators",
    "Chamber": "softcal_jax.actuators",
    "Configuration": "softcal_jax.configurations",
    "ControlPointParameters": "softcal_jax.fields",
    "ControlPoints": "softcal_jax.fields",
    "Corotational": "softcal_jax.materials",
    "EdgeForce": "softcal_jax.configurations",
    "Fibre": "softcal_jax.materials",
    "Guide": "softcal_jax.actuators",
    "ImposedDisplacement": "softcal_jax.configurations",
    "ImposedForce": "softcal_jax.configurations",
    "Isotropic": "softcal_jax.materials",
    "Markers": "softcal_jax.configurations",
    "Motor": "softcal_jax.actuators",
    "NeoHookean": "softcal_jax.materials",
    "Parameter": "softcal_jax.fields",
    "ParameterSpace": "softcal_jax.fields",
    "Pose": "softcal_jax.bodies",
    "ReducedTransverseIsotropic": "softcal_jax.materials",
    "RigidBody": "softcal_jax.bodies",
    "Support": "softcal_jax.configurations",
    "assess": "softcal_jax.identifiability",
    "beam": "softcal_jax.mesh",
    "build_model": "softcal_jax.equilibrium",
    "calibrate": "softcal_jax.calibration",
    "compare_laws": "softcal_jax.layouts",
    "export_icesl": "softcal_jax.exchange.icesl",
    "export_inp": "softcal_jax.exchange.inp",
    "export_sofa": "softcal_jax.exchange.sofa",
    "identify": "softcal_jax.identifiability",
    "load_project": "softcal_jax.project",
    "load_result": "softcal_jax.report",
    "profile_intervals": "softcal_jax.calibration",
    "rank_configurations": "softcal_jax.identifiability",
    "read_markers": "softcal_jax.configurations",
    "read_mesh": "softcal_jax.mesh",
    "read_poses": "softcal_jax.configurations",
    "register": "softcal_jax.configurations",
    "select_nodes": "softcal_jax.mesh",
    "simulated_measurements": "softcal_jax.calibration",
    "solve_equilibrium": "softcal_jax.equilibrium",
    "solve_inverse": "softcal_jax.control",
    "synthetic_measurements": "softcal_jax.calibration",
    "use_compilation_cache": "softcal_jax._compilation_cache",
    "write_results": "softcal_jax.report",
}
"""Where each name is from; it is imported on first use, as that takes seconds."""

__all__ = [
    "ActuatorDisplacement",
    "BodyFrame",
    "Cable",
    "Chamber",
    "Configuration",
    "ControlPointParameters",
    "ControlPoints",
    "Corotational",
    "EdgeForce",
    "Fibre",
    "Guide",
    "ImposedDisplacement",
    "ImposedForce",
    "Isotropic",
    "Markers",
    "Motor",
    "NeoHookean",
    "Parameter",
    "ParameterSpace",
    "Pose",
    "ReducedTransverseIsotropic",
    "RigidBody",
    "Support",
    "assess",
    "beam",
    "build_model",
    "calibrate",
    "compare_laws",
    "export_icesl",
    "export_inp",
    "export_sofa",
    "identify",
    "load_project",
    "load_result",
    "profile_intervals",
    "rank_configurations",
    "read_markers",
    "read_mesh",
    "read_poses",
    "register",
    "select_nodes",
    "simulated_measurements",
    "solve_equilibrium",
    "solve_inverse",
    "synthetic_measurements",
    "use_compilation_cache",
    "write_results",
]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
