"""Rigid bodies: groups of nodes that move as one frame."""

from softcal_jax.bodies._arrays import BodyArrays, BodyStateArrays, body_arrays
from softcal_jax.bodies._body import (
    KINDS,
    BodyState,
    Pose,
    RigidBody,
    Vector,
    as_floats,
    hinge_axes,
    optional_array,
    three_numbers,
    unit_vector,
)
from softcal_jax.bodies._kinematics import (
    Frames,
    Mounted,
    blocked,
    frame_nodes,
    frames_at,
    mounted,
    place,
    rotation_matrix,
    rotation_vector,
)

__all__ = [
    "KINDS",
    "BodyArrays",
    "BodyState",
    "BodyStateArrays",
    "Frames",
    "Mounted",
    "Pose",
    "RigidBody",
    "Vector",
    "as_floats",
    "blocked",
    "body_arrays",
    "frame_nodes",
    "frames_at",
    "hinge_axes",
    "mounted",
    "optional_array",
    "place",
    "rotation_matrix",
    "rotation_vector",
    "three_numbers",
    "unit_vector",
]
