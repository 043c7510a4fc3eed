"""Rigid bodies: groups of nodes that move as one frame."""

from softcal_jax.bodies._arrays import BodyArrays, BodyStateArrays, body_arrays
from softcal_jax.bodies._body import (
    KINDS,
    BodyState,
    Pose,
    RigidBody,
    Vector,
    as_vector,
    check_vector,
    hinge_axes,
)
from softcal_jax.bodies._kinematics import (
    Frames,
    Mounted,
    blocked,
    cross_matrix,
    frame_nodes,
    frames_at,
    mounted,
    place,
    rotation_matrix,
    rotation_vector,
    winding,
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
    "as_vector",
    "blocked",
    "body_arrays",
    "check_vector",
    "cross_matrix",
    "frame_nodes",
    "frames_at",
    "hinge_axes",
    "mounted",
    "place",
    "rotation_matrix",
    "rotation_vector",
    "winding",
]
