"""Calibrate the finite-element model of a soft robot from a few measured poses.

The packages follow the method step by step: `mesh`, `elements`, `materials`, `fields`,
`configurations`, `equilibrium`, `sensitivity`, `calibration`, `identifiability`,
`control`, `layouts`. What a script needs most stands here as well.
"""

from importlib.metadata import version

from softcal_jax import (
    calibration,
    configurations,
    control,
    elements,
    equilibrium,
    fields,
    identifiability,
    layouts,
    materials,
    mesh,
    sensitivity,
)
from softcal_jax.calibration import (
    CalibrationResult,
    CalibrationSettings,
    build_problem,
    calibrate,
    multi_start,
    synthetic_measurements,
)
from softcal_jax.configurations import (
    Configuration,
    EdgeForce,
    Markers,
    NodalForces,
    PointForce,
    Support,
    SurfaceForce,
    SurfaceTraction,
    configuration_arrays,
    register,
)
from softcal_jax.control import follow_trajectory, sample_workspace, solve_inverse
from softcal_jax.equilibrium import (
    RESULTS,
    Model,
    NewtonSettings,
    build_model,
    check_converged,
    marker_positions,
    solve_equilibrium,
)
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    Parameter,
    ParameterSpace,
    set_field,
)
from softcal_jax.identifiability import assess, identify, rank_configurations
from softcal_jax.layouts import compare_layouts, place_control_points
from softcal_jax.materials import (
    AbstractLaw,
    ClassicalCorotational,
    Corotational,
    Fibre,
    FibreReinforced,
    Isotropic,
    NeoHookean,
    ReducedTransverseIsotropic,
    StVenantKirchhoff,
    TransverseIsotropic,
)
from softcal_jax.mesh import TetMesh, beam, read_mesh, select_nodes, to_quadratic

__version__ = version("softcal-jax")

__all__ = [
    "RESULTS",
    "AbstractLaw",
    "CalibrationResult",
    "CalibrationSettings",
    "ClassicalCorotational",
    "Configuration",
    "ControlPointParameters",
    "ControlPoints",
    "Corotational",
    "EdgeForce",
    "Fibre",
    "FibreReinforced",
    "Isotropic",
    "Markers",
    "Model",
    "NeoHookean",
    "NewtonSettings",
    "NodalForces",
    "Parameter",
    "ParameterSpace",
    "PointForce",
    "ReducedTransverseIsotropic",
    "StVenantKirchhoff",
    "Support",
    "SurfaceForce",
    "SurfaceTraction",
    "TetMesh",
    "TransverseIsotropic",
    "assess",
    "beam",
    "build_model",
    "build_problem",
    "calibrate",
    "calibration",
    "check_converged",
    "compare_layouts",
    "configuration_arrays",
    "configurations",
    "control",
    "elements",
    "equilibrium",
    "fields",
    "follow_trajectory",
    "identifiability",
    "identify",
    "layouts",
    "marker_positions",
    "materials",
    "mesh",
    "multi_start",
    "place_control_points",
    "rank_configurations",
    "read_mesh",
    "register",
    "sample_workspace",
    "select_nodes",
    "sensitivity",
    "set_field",
    "solve_equilibrium",
    "solve_inverse",
    "synthetic_measurements",
    "to_quadratic",
]
