"""Actuators: their displacement delta_a, and the force on the nodes per lambda_a."""

from softcal_jax.actuators._actuator import AbstractActuator, ActuatorGeometry, Kind
from softcal_jax.actuators._arrays import (
    ActuatorArrays,
    actuator_arrays,
    actuator_displacements,
    actuator_geometry,
    actuator_rows,
    actuators_moving,
    clique_nodes,
    curvature_entries,
    displacement_rows,
)
from softcal_jax.actuators._cable import Cable, CableSegments, Guide
from softcal_jax.actuators._forces import ForceActuator, Motor, SurfaceForceActuator
from softcal_jax.actuators._lid import ChamberLids, free_rim_nodes
from softcal_jax.actuators._pressure import (
    Chamber,
    ChamberFaces,
    PressureFaces,
    SurfacePressure,
    enclosed_volumes,
)

__all__ = [
    "AbstractActuator",
    "ActuatorArrays",
    "ActuatorGeometry",
    "Cable",
    "CableSegments",
    "Chamber",
    "ChamberFaces",
    "ChamberLids",
    "ForceActuator",
    "Guide",
    "Kind",
    "Motor",
    "PressureFaces",
    "SurfaceForceActuator",
    "SurfacePressure",
    "actuator_arrays",
    "actuator_displacements",
    "actuator_geometry",
    "actuator_rows",
    "actuators_moving",
    "clique_nodes",
    "curvature_entries",
    "displacement_rows",
    "enclosed_volumes",
    "free_rim_nodes",
]
