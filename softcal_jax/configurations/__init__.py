"""Posed robots: supports, loads, measured points, and the arrays they become."""

from softcal_jax.configurations._arrays import (
    ConfigurationArrays as ConfigurationArrays,
    EffectorArrays as EffectorArrays,
    Observed as Observed,
    earlier_lanes as earlier_lanes,
    following_each_other as following_each_other,
    in_order as in_order,
)
from softcal_jax.configurations._boundary import (
    LOADS as LOADS,
    AbstractLoad as AbstractLoad,
    EdgeForce as EdgeForce,
    NodalForces as NodalForces,
    PointForce as PointForce,
    Support as Support,
    SurfaceForce as SurfaceForce,
    SurfaceTraction as SurfaceTraction,
)
from softcal_jax.configurations._configuration import (
    STANDARD_GRAVITY as STANDARD_GRAVITY,
    Configuration as Configuration,
    ConfigurationLanes as ConfigurationLanes,
    beyond as beyond,
    configuration_arrays as configuration_arrays,
    configuration_lanes as configuration_lanes,
)
from softcal_jax.configurations._csv_table import read_table as read_table
from softcal_jax.configurations._effector import (
    AbstractEffector as AbstractEffector,
    AbstractScalar as AbstractScalar,
    EffectorRecord as EffectorRecord,
    Unstated as Unstated,
    check_numbers as check_numbers,
    farthest as farthest,
    motions as motions,
    rms_distance as rms_distance,
)
from softcal_jax.configurations._effectors import (
    EFFECTORS as EFFECTORS,
    ActuatorDisplacement as ActuatorDisplacement,
    ActuatorForce as ActuatorForce,
    BodyAngle as BodyAngle,
    BodyFrame as BodyFrame,
    Centroid as Centroid,
    ContactForce as ContactForce,
    ContactMoment as ContactMoment,
    Observation as Observation,
    SupportReaction as SupportReaction,
)
from softcal_jax.configurations._markers import (
    STD as STD,
    Markers as Markers,
    MarkerTable as MarkerTable,
    Registration as Registration,
    read_markers as read_markers,
    register as register,
)
from softcal_jax.configurations._mechanism import (
    OTHER_POINTS as OTHER_POINTS,
    ImposedDisplacement as ImposedDisplacement,
    ImposedForce as ImposedForce,
    Mechanism as Mechanism,
    actuation_arrays as actuation_arrays,
    build_mechanism as build_mechanism,
)
from softcal_jax.configurations._recording import (
    Recording as Recording,
    Traces as Traces,
)
from softcal_jax.configurations._recording_file import (
    is_recording as is_recording,
    read_c3d as read_c3d,
    read_recording as read_recording,
)
from softcal_jax.configurations._tracker import (
    PoseTable as PoseTable,
    TrackerWarning as TrackerWarning,
    from_quaternion as from_quaternion,
    read_polhemus as read_polhemus,
    read_poses as read_poses,
)
