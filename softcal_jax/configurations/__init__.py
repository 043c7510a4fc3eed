"""Posed robots: supports, loads, measured points, and the arrays they become."""

from softcal_jax.configurations._arrays import (
    ConfigurationArrays,
    EffectorArrays,
)
from softcal_jax.configurations._configuration import (
    STANDARD_GRAVITY,
    Configuration,
    ConfigurationLanes,
    configuration_arrays,
    configuration_lanes,
    measured_as,
    measured_at_rest,
)
from softcal_jax.configurations._csv_table import read_table
from softcal_jax.configurations._effector import (
    AbstractEffector,
    AbstractScalar,
    EffectorRecord,
    Unstated,
    farthest,
    motions,
)
from softcal_jax.configurations._effectors import (
    ActuatorDisplacement,
    ActuatorForce,
    BodyAngle,
    BodyFrame,
    Centroid,
    SupportReaction,
)
from softcal_jax.configurations._loads import (
    AbstractLoad,
    EdgeForce,
    NodalForces,
    PointForce,
    SurfaceForce,
    SurfaceTraction,
)
from softcal_jax.configurations._marker_table import (
    MarkerTable,
    Registration,
    read_markers,
    register,
)
from softcal_jax.configurations._markers import STD, Markers
from softcal_jax.configurations._mechanism import (
    ImposedDisplacement,
    ImposedForce,
    Mechanism,
    actuation_arrays,
    build_mechanism,
)
from softcal_jax.configurations._recording import Recording, Traces
from softcal_jax.configurations._recording_file import (
    is_recording,
    read_c3d,
    read_recording,
)
from softcal_jax.configurations._supports import Support
from softcal_jax.configurations._tracker import (
    PoseTable,
    TrackerWarning,
    average_poses,
    in_frame,
    read_polhemus,
    read_poses,
)
from softcal_jax.configurations._wide_table import read_wide_table

__all__ = [
    "STANDARD_GRAVITY",
    "STD",
    "AbstractEffector",
    "AbstractLoad",
    "AbstractScalar",
    "ActuatorDisplacement",
    "ActuatorForce",
    "BodyAngle",
    "BodyFrame",
    "Centroid",
    "Configuration",
    "ConfigurationArrays",
    "ConfigurationLanes",
    "EdgeForce",
    "EffectorArrays",
    "EffectorRecord",
    "ImposedDisplacement",
    "ImposedForce",
    "MarkerTable",
    "Markers",
    "Mechanism",
    "NodalForces",
    "PointForce",
    "PoseTable",
    "Recording",
    "Registration",
    "Support",
    "SupportReaction",
    "SurfaceForce",
    "SurfaceTraction",
    "Traces",
    "TrackerWarning",
    "Unstated",
    "actuation_arrays",
    "average_poses",
    "build_mechanism",
    "configuration_arrays",
    "configuration_lanes",
    "farthest",
    "in_frame",
    "is_recording",
    "measured_as",
    "measured_at_rest",
    "motions",
    "read_c3d",
    "read_markers",
    "read_polhemus",
    "read_poses",
    "read_recording",
    "read_table",
    "read_wide_table",
    "register",
]
