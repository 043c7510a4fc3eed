"""Rigid bodies: groups of nodes that move as one frame."""

from softcal_jax.bodies._arrays import (
    BodyArrays as BodyArrays,
    BodyStateArrays as BodyStateArrays,
    Frames as Frames,
    Mounted as Mounted,
    body_arrays as body_arrays,
)
from softcal_jax.bodies._body import (
    KINDS as KINDS,
    BodyState as BodyState,
    Pose as Pose,
    RigidBody as RigidBody,
    as_floats as as_floats,
    hinge_axes as hinge_axes,
    optional as optional,
    three_numbers as three_numbers,
    unit_vector as unit_vector,
)
from softcal_jax.bodies._kinematics import (
    angle_about as angle_about,
    rotation_matrix as rotation_matrix,
    rotation_vector as rotation_vector,
    winding as winding,
)
