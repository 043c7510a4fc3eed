"""Rotations of rigid bodies, and the path on which one winds to an imposed pose."""

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.bodies._body import hinge_axes

# Squared angle below which the series are exact to rounding [rad2].
_SMALL = 1e-4

WIND = 0.05
"""Singular value of a screw below which its strain is no longer followed [-]."""

_SIGNS = np.cross(np.eye(3)[:, None], -np.eye(3)[None])
"""Minus the permutation symbol: hat(w)_ij = sum_k _SIGNS_ijk w_k."""


def cross_matrix(w: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Return the matrix hat(w) that maps v to w x v."""
    # Compiles to two operations, where stacking the entries would take twenty.
    return jnp.sum(jnp.asarray(_SIGNS, w.dtype) * w[None, None], axis=2)


def rotation_matrix(w: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Compute the matrix exp(hat(w)) of a rotation vector [rad] (Rodrigues)."""
    square, W = jnp.sum(w * w), cross_matrix(w)
    return jnp.eye(3) + _sinc(square) * W + _versine(square) * (W @ W)


def _safe_angle(square: Float[Array, ""]) -> Float[Array, ""]:
    """Return the angle with this square, and 1 where a series replaces its quotients.

    Under autodiff, the branch that is not selected must not divide by zero either.
    """
    return jnp.sqrt(jnp.where(square < _SMALL, 1.0, square))


def _sinc(square: Float[Array, ""]) -> Float[Array, ""]:
    """Compute sin(a) / a of the angle a with this square."""
    angle = _safe_angle(square)
    series = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
    return jnp.where(square < _SMALL, series, jnp.sin(angle) / angle)


def _versine(square: Float[Array, ""]) -> Float[Array, ""]:
    """Compute (1 - cos a) / a^2, by half the angle so that nothing cancels."""
    return 0.5 * _sinc(0.25 * square) ** 2


def rotation_vector(R: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Compute the rotation vector of a rotation matrix, of length 0 to pi [rad].

    Goes through the unit quaternion, largest component first (Shepperd, J. Guidance
    Control 1, 1978), which is accurate at all angles, half a turn included.
    """
    trace = jnp.trace(R)
    four = 1.0 + jnp.concatenate([trace[None], 2.0 * jnp.diag(R) - trace])
    off = jnp.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    both = R + R.T
    rows = [
        jnp.stack([four[0], off[0], off[1], off[2]]),
        jnp.stack([off[0], four[1], both[0, 1], both[0, 2]]),
        jnp.stack([off[1], both[0, 1], four[2], both[1, 2]]),
        jnp.stack([off[2], both[0, 2], both[1, 2], four[3]]),
    ]
    largest = jnp.argmax(four)
    q = jnp.stack(rows)[largest] / (2.0 * jnp.sqrt(four[largest]))
    q = jnp.where(q[0] < 0.0, -q, q)
    square = jnp.sum(q[1:] ** 2)
    small, sine = square < _SMALL, _safe_angle(square)
    # 2 arcsin(s) / s, with s the sine of half the angle.
    series = 2.0 + square / 3.0 * (1.0 + square * 9.0 / 20.0 * (1.0 + square * 25 / 42))
    factor = jnp.where(small, series, 2.0 * jnp.arctan2(sine, q[0]) / sine)
    return factor * q[1:]


def angle_about(
    R: Float[Array, "3 3"], other: Float[Array, "3 3"], axis: Float[HostArray, "3"]
) -> Float[Array, ""]:
    """Compute the angle of the rotation other^T R about an axis fixed on the other."""
    relative = jnp.sum(other[:, :, None] * R[:, None, :], axis=0)
    first, second, _ = hinge_axes(axis)
    turned = jnp.sum(relative * first[None, :], axis=1)
    return jnp.arctan2(jnp.sum(turned * second), jnp.sum(turned * first))


def _screw(w: Float[Array, "3"]) -> tuple[Float[Array, "3 3"], Float[Array, "3 3"]]:
    """Return V of the screw (R, V e) = exp(w, e), and a V^+ that is bounded.

    With the cross product W of w and the angle a = |w| (Murray, Li and Sastry, A
    Mathematical Introduction to Robotic Manipulation, 1994, ch. 2),

        V = I + (1 - cos a) / a^2 W + (a - sin a) / a^3 W^2.

    It has the singular value 1 along the axis and m = 2 sin(a / 2) / a across, which
    vanishes after a full turn: V^+ = V^T (V V^T + WIND^2)^-1.
    """
    square = jnp.sum(w * w)
    small = square < _SMALL
    angle, first = _safe_angle(square), _versine(square)
    second = jnp.where(
        small,
        1.0 / 6.0 - square / 120.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0)),
        (angle - jnp.sin(angle)) / angle**3,
    )
    W = cross_matrix(w)
    W2 = W @ W
    V = jnp.eye(3) + first * W + second * W2
    across = 2.0 * first
    along = 1.0 / (1.0 + WIND**2)
    # -W^2 / a^2 projects onto the plane across the axis.
    more = jnp.where(small, 0.0, (along - 1.0 / (across + WIND**2)) / angle**2)
    return V, V.T @ (along * jnp.eye(3) + more * W2)


def winding(
    arm: Float[Array, "3"],
    translation: Float[Array, "3"],
    rotation: Float[Array, "3"],
    load: Float[Array, ""],
) -> Float[Array, "3"]:
    """Return how far the path to an imposed pose lies from a straight line [m].

    Seen from the point about which it winds, a body at p with the rotation vector w is
    the end of a rod with the constant strain e: p = V(w) e. On its path, e and w change
    in proportion to the load, so that a beam is bent along arcs of circles without
    being stretched or crushed: on a straight path to three quarters of a circle, its
    end would come as close as 0.4 of its length. The result is zero at both ends of the
    path, whatever the pose, and is not differentiated by the pose, because
    sensitivities are taken only at the end of the path.

    `arm` leads from that point to the origin of the body at rest [m]; translation [m]
    and rotation vector [rad] are those at full load.
    """
    arm, translation, rotation = jax.lax.stop_gradient((arm, translation, rotation))
    V, inverse = _screw(rotation)
    strain = arm + inverse @ (arm + translation - V @ arm)
    on_path = _screw(load * rotation)[0] @ ((1.0 - load) * arm + load * strain)
    return on_path - arm - load * (V @ strain - arm)
