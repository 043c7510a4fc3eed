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
from softcal_jax.configurations._markers import STD as STD, Markers as Markers
from softcal_jax.configurations._mechanism import (
    OTHER_POINTS as OTHER_POINTS,
    ImposedDisplacement as ImposedDisplacement,
    ImposedForce as ImposedForce,
    Mechanism as Mechanism,
    actuation_arrays as actuation_arrays,
    build_mechanism as build_mechanism,
)
