"""Calibrate the finite-element model of a soft robot from a few measured poses.

This module offers what a notebook needs. The rest is in the packages, which follow the
method step by step: `mesh`, `materials`, `fields`, `bodies`, `actuators`,
`configurations`, `equilibrium`, `sensitivity`, `calibration`, `identifiability`,
`control`, `layouts`.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

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

if TYPE_CHECKING:
    from softcal_jax.project import load_project
    from softcal_jax.report import (
        export_icesl,
        export_inp,
        load_result,
        write_results,
    )
    from softcal_jax.sofa import export_sofa

__version__ = version("softcal-jax")

_ON_DEMAND = {
    "export_icesl": "softcal_jax.report",
    "export_inp": "softcal_jax.report",
    "export_sofa": "softcal_jax.sofa",
    "load_project": "softcal_jax.project",
    "load_result": "softcal_jax.report",
    "write_results": "softcal_jax.report",
}
"""Names that are imported on first use, since their packages take long to load."""

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
    if name in _ON_DEMAND:
        return getattr(import_module(_ON_DEMAND[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_ON_DEMAND})
