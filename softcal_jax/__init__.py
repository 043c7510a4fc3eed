"""Calibrate the finite-element model of a soft robot from a few measured poses.

The packages follow the method step by step: `mesh`, `elements`, `materials`, `fields`,
`configurations`, `equilibrium`, `sensitivity`, `calibration`. What a script needs most
stands here as well.
"""

from importlib.metadata import version

from softcal_jax import (
    calibration,
    configurations,
    elements,
    equilibrium,
    fields,
    materials,
    mesh,
    sensitivity,
)
from softcal_jax.calibration import CalibrationResult, CalibrationSettings, calibrate
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
from softcal_jax.equilibrium import (
    RESULTS,
    Model,
    NewtonSettings,
    build_model,
    check_converged,
    marker_positions,
    solve_equilibrium,
)
from softcal_jax.fields import Parameter, ParameterSpace, set_field
from softcal_jax.materials import (
    AbstractLaw,
    Corotational,
    Isotropic,
    NeoHookean,
    StVenantKirchhoff,
)
from softcal_jax.mesh import TetMesh, beam, read_mesh, select_nodes, to_quadratic

__version__ = version("softcal-jax")

__all__ = [
    "RESULTS",
    "AbstractLaw",
    "CalibrationResult",
    "CalibrationSettings",
    "Configuration",
    "Corotational",
    "EdgeForce",
    "Isotropic",
    "Markers",
    "Model",
    "NeoHookean",
    "NewtonSettings",
    "NodalForces",
    "Parameter",
    "ParameterSpace",
    "PointForce",
    "StVenantKirchhoff",
    "Support",
    "SurfaceForce",
    "SurfaceTraction",
    "TetMesh",
    "beam",
    "build_model",
    "calibrate",
    "calibration",
    "check_converged",
    "configuration_arrays",
    "configurations",
    "elements",
    "equilibrium",
    "fields",
    "marker_positions",
    "materials",
    "mesh",
    "read_mesh",
    "register",
    "select_nodes",
    "sensitivity",
    "set_field",
    "solve_equilibrium",
    "to_quadratic",
]
