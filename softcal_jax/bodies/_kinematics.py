"""Kinematics of rigid bodies: frames, mounting and twists.

A step of a body is a twist: three displacements of the origin of its frame and three
angles, along its mounted axes. Angles count in metres at the ends of the frame's axes
(times `BodyArrays.length`), so that all unknowns have one unit.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.bodies._arrays import BodyArrays, BodyStateArrays
from softcal_jax.bodies._body import KINDS
from softcal_jax.bodies._rotations import rotation_matrix


class Frames(NamedTuple):
    """Poses of the frames of the bodies.

    Attributes:
        origin: Origins [m].
        rotation: Rotations from rest [-].
    """

    origin: Float[Array, "n_b 3"]
    rotation: Float[Array, "n_b 3 3"]

    def where(self, mask: Bool[Array, " n_b"], others: "Frames") -> "Frames":
        """Take those of some bodies, and other frames elsewhere."""
        return Frames(
            jnp.where(mask[:, None], self.origin, others.origin),
            jnp.where(mask[:, None, None], self.rotation, others.rotation),
        )


def frames_at(bodies: BodyArrays, ends: Float[Array, "n_frame_nodes 3"]) -> Frames:
    """Compute frames from the positions of the frame nodes, four per body [m].

    Axes are orthogonalised in case a linear prediction distorted them.
    """
    ends = ends.reshape(bodies.n_bodies, 4, 3)
    now = (ends[:, 1:] - ends[:, :1]) / bodies.length
    first = now[:, 0] / jnp.linalg.norm(now[:, 0], axis=1, keepdims=True)
    second = now[:, 1] - first * jnp.sum(first * now[:, 1], axis=1, keepdims=True)
    second = second / jnp.linalg.norm(second, axis=1, keepdims=True)
    orthogonal = jnp.stack([first, second, jnp.cross(first, second)], axis=1)
    rotation = jnp.sum(orthogonal[:, :, :, None] * bodies.axes[:, :, None, :], axis=1)
    return Frames(ends[:, 0], rotation)


def frame_nodes(bodies: BodyArrays, frames: Frames) -> Float[Array, "n_b 4 3"]:
    """Compute the positions of the frame nodes [m]."""
    axes = _apply(frames.rotation[:, None], jnp.asarray(bodies.axes))
    ends = frames.origin[:, None] + bodies.length * axes
    return jnp.concatenate([frames.origin[:, None], ends], axis=1)


def _apply(R: Float[Array, "... 3 3"], v: Float[Array, "... 3"]):
    """Compute R v for stacks of both."""
    return jnp.sum(R * v[..., None, :], axis=-1)


class Mounted(NamedTuple):
    """Frames after a share of their mounting.

    Attributes:
        load: The share, which also applies to imposed poses [-].
        rotation: Rotations of the mountings.
        axes: Axes of the frames, by rows [-].
    """

    load: Float[Array, ""]
    rotation: Float[Array, "n_b 3 3"]
    axes: Float[Array, "n_b 3 3"]


def mounted(bodies: BodyArrays, load: Float[Array, ""]) -> Mounted:
    """Turn the frames by a share of their mounting."""
    R = jax.vmap(rotation_matrix)(load * bodies.mounting_rotation)
    return Mounted(load, R, _apply(R[:, None], jnp.asarray(bodies.axes)))


def place(
    bodies: BodyArrays,
    state: BodyStateArrays,
    mounted: Mounted,
    frames: Frames,
    twist: Float[Array, "n_b 6"],
) -> Frames:
    """Apply a twist to the free bodies, and put all others in their places.

    Args:
        bodies: The bodies.
        state: Their states in the configuration.
        mounted: Share of mountings and imposed poses that is applied.
        frames: Frames before the twist.
        twist: Twist of each body along its mounted axes, angles in metres [m].
    """
    load, mounting, axes = mounted
    along = lambda v: jnp.sum(axes * v[:, :, None], axis=1)
    rest = jnp.asarray(bodies.origin)
    home = rest + load * (bodies.mounting_translation + state.translation)
    turned = _product(frames.rotation, jnp.swapaxes(mounting, 1, 2))
    angle = _hinge_angle(turned, axes) + twist[:, 5] / bodies.length
    turns = [
        along(twist[:, 3:]) / bodies.length,
        angle[:, None] * axes[:, 2],
        load * state.rotation,
    ]
    # One stacked call, since each separate one would be compiled again.
    by_twist, by_angle, by_pose = jax.vmap(jax.vmap(rotation_matrix))(jnp.stack(turns))
    free = Frames(
        frames.origin + along(twist[:, :3]), _product(by_twist, frames.rotation)
    )
    hinged = Frames(home, _product(by_angle, mounting))
    held = Frames(home, _product(by_pose, mounting))
    own = hinged.where(state.kind == KINDS.index("hinged"), held)
    own = free.where(state.kind == KINDS.index("free"), own)
    # A tied body follows its owner, after its own mounting.
    arm = rest + load * bodies.mounting_translation - rest[bodies.owner]
    origin, rotation = own.origin[bodies.owner], own.rotation[bodies.owner]
    tied = Frames(origin + _apply(rotation, arm), _product(rotation, mounting))
    return tied.where(bodies.tied, own)


def _product(A: Float[Array, "n_b 3 3"], B: Float[Array, "n_b 3 3"]):
    return jnp.sum(A[:, :, :, None] * B[:, None], axis=2)


def _hinge_angle(R: Float[Array, "n_b 3 3"], axes: Float[Array, "n_b 3 3"]):
    """Compute the angle of each rotation about the third axis [rad]."""
    first = _apply(R, axes[:, 0])
    return jnp.arctan2(
        jnp.sum(first * axes[:, 1], axis=1), jnp.sum(first * axes[:, 0], axis=1)
    )


def blocked(state: BodyStateArrays, bodies: BodyArrays):
    """Flag the entries of the twists that are not unknowns."""
    kind = state.kind[:, None]
    hinge = jnp.arange(6)[None] == 5
    free = (kind == KINDS.index("free")) | ((kind == KINDS.index("hinged")) & hinge)
    return ~free | bodies.tied[:, None]
