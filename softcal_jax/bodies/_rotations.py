"""Differentiable conversion between rotation vectors and matrices."""

import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float

# Squared angle below which the series are exact to rounding [rad2].
_SMALL = 1e-4


# Signs of the permutations: hat(w)_ij = sum_k _SIGNS_ijk w_k.
_SIGNS = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _SIGNS[_i, _j, _k], _SIGNS[_j, _i, _k] = -1.0, 1.0


def cross_matrix(w: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Return the matrix hat(w) that maps a vector v to w x v."""
    # Compiles to two operations, where stacking the entries would take twenty.
    return jnp.sum(jnp.asarray(_SIGNS, w.dtype) * w[None, None], axis=2)


def rotation_matrix(w: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Compute the rotation matrix exp(hat(w)) by Rodrigues' formula.

    Args:
        w: Rotation vector [rad].
    """
    square = jnp.sum(w * w)
    small = square < _SMALL
    # Under autodiff, the unselected branch must not divide by zero either.
    angle = jnp.sqrt(jnp.where(small, 1.0, square))
    sine = jnp.where(
        small,
        1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0)),
        jnp.sin(angle) / angle,
    )
    versine = jnp.where(
        small,
        0.5 - square / 24.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0)),
        (1.0 - jnp.cos(angle)) / angle**2,
    )
    W = cross_matrix(w)
    return jnp.eye(3) + sine * W + versine * (W @ W)


def rotation_vector(R: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Compute the rotation vector of a rotation matrix, of length 0 to pi [rad].

    Goes through the unit quaternion, largest component first (Shepperd, J. Guidance
    Control 1, 1978), which is accurate at all angles, half a turn included.
    """
    trace = jnp.trace(R)
    four = 1.0 + jnp.concatenate([trace[None], 2.0 * jnp.diag(R) - trace])
    off = jnp.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    both = R + R.T
    rows = jnp.stack(
        [
            jnp.stack([four[0], off[0], off[1], off[2]]),
            jnp.stack([off[0], four[1], both[0, 1], both[0, 2]]),
            jnp.stack([off[1], both[0, 1], four[2], both[1, 2]]),
            jnp.stack([off[2], both[0, 2], both[1, 2], four[3]]),
        ]
    )
    largest = jnp.argmax(four)
    q = rows[largest] / (2.0 * jnp.sqrt(four[largest]))
    q = jnp.where(q[0] < 0.0, -q, q)
    square = jnp.sum(q[1:] ** 2)
    small = square < _SMALL
    sine = jnp.sqrt(jnp.where(small, 1.0, square))
    # 2 arcsin(s) / s, with s the sine of half the angle.
    series = 2.0 + square / 3.0 * (1.0 + square * 9.0 / 20.0 * (1.0 + square * 25 / 42))
    factor = jnp.where(small, series, 2.0 * jnp.arctan2(sine, q[0]) / sine)
    return factor * q[1:]
