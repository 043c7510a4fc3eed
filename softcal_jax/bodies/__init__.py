"""Rigid bodies: groups of nodes that move as one frame."""

from softcal_jax.bodies._body import (
    KINDS as KINDS,
    BodyArrays as BodyArrays,
    BodyState as BodyState,
    BodyStateArrays as BodyStateArrays,
    Pose as Pose,
    RigidBody as RigidBody,
    Vector as Vector,
    as_floats as as_floats,
    body_arrays as body_arrays,
    hinge_axes as hinge_axes,
    optional as optional,
    three_numbers as three_numbers,
    unit_vector as unit_vector,
)
from softcal_jax.bodies._kinematics import (
    Frames as Frames,
    Mounted as Mounted,
    angle_about as angle_about,
    blocked as blocked,
    frame_nodes as frame_nodes,
    frames_at as frames_at,
    mounted as mounted,
    place as place,
    rotation_matrix as rotation_matrix,
    rotation_vector as rotation_vector,
    winding as winding,
)
