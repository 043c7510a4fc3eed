"""Posed robots: supports, loads, measured points, and the arrays they become."""

from softcal_jax.configurations._arrays import ConfigurationArrays, EffectorArrays
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
from softcal_jax.configurations._registration import Registration, register
from softcal_jax.configurations._supports import Support

__all__ = [
    "STANDARD_GRAVITY",
    "AbstractLoad",
    "Configuration",
    "ConfigurationArrays",
    "EdgeForce",
    "EffectorArrays",
    "MarkerTable",
    "Markers",
    "NodalForces",
    "PointForce",
    "Registration",
    "Support",
    "SurfaceForce",
    "SurfaceTraction",
    "configuration_arrays",
    "read_markers",
    "register",
]
