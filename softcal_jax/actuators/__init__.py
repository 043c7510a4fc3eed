"""Actuators: their displacement delta_a, and the force on the nodes per lambda_a."""

from softcal_jax.actuators._actuator import (
    AbstractActuator as AbstractActuator,
    AbstractCliques as AbstractCliques,
    AbstractDisplacedCliques as AbstractDisplacedCliques,
    ActuatorGeometry as ActuatorGeometry,
    ForceActuator as ForceActuator,
    Kind as Kind,
    Motor as Motor,
    RestState as RestState,
    SurfaceForceActuator as SurfaceForceActuator,
    WeightedNodes as WeightedNodes,
    owned as owned,
)
from softcal_jax.actuators._arrays import (
    ActuatorArrays as ActuatorArrays,
    actuator_arrays as actuator_arrays,
    actuator_geometry as actuator_geometry,
)
from softcal_jax.actuators._cable import (
    AbstractGuided as AbstractGuided,
    Cable as Cable,
    CableSegments as CableSegments,
    Guide as Guide,
)
from softcal_jax.actuators._pressure import (
    Chamber as Chamber,
    ChamberLids as ChamberLids,
    SurfacePressure as SurfacePressure,
    enclosed_volumes as enclosed_volumes,
    free_rim_nodes as free_rim_nodes,
)

ACTUATORS: dict[str, type[AbstractActuator]] = {
    "cable": Cable,
    "chamber": Chamber,
    "surface-pressure": SurfacePressure,
    "motor": Motor,
    "point-force": ForceActuator,
    "surface-force": SurfaceForceActuator,
}
"""The actuators, as project files name them."""
