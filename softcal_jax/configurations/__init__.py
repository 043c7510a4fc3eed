"""Posed robots: supports, loads, measured points, and the arrays they become."""

from softcal_jax.configurations._actuation import (
    ImposedDisplacement,
    ImposedForce,
)
from softcal_jax.configurations._arrays import (
    ActuationArrays,
    ConfigurationArrays,
    EffectorArrays,
)
from softcal_jax.configurations._configuration import (
    STANDARD_GRAVITY,
    Configuration,
    configuration_arrays,
)
from softcal_jax.configurations._loads import (
    AbstractLoad,
    EdgeForce,
    NodalForces,
    PointForce,
    SurfaceForce,
    SurfaceTraction,
)
from softcal_jax.configurations._markers import Markers
from softcal_jax.configurations._measurements import MarkerTable, read_markers
from softcal_jax.configurations._mechanism import Mechanism, build_mechanism
from softcal_jax.configurations._registration import Registration, register
from softcal_jax.configurations._supports import Support

__all__ = [
    "STANDARD_GRAVITY",
    "AbstractLoad",
    "ActuationArrays",
    "Configuration",
    "ConfigurationArrays",
    "EdgeForce",
    "EffectorArrays",
    "ImposedDisplacement",
    "ImposedForce",
    "MarkerTable",
    "Markers",
    "Mechanism",
    "NodalForces",
    "PointForce",
    "Registration",
    "Support",
    "SurfaceForce",
    "SurfaceTraction",
    "build_mechanism",
    "configuration_arrays",
    "read_markers",
    "register",
]
