"""Rotations against SciPy, at every angle and with their derivatives."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from problems import assert_second_order
from scipy.spatial.transform import Rotation

from softcal_jax.bodies import rotation_matrix, rotation_vector

AXIS = np.array([0.36, -0.48, 0.8])
# Both sides of the angle where a series takes over (0.01 in the matrix, 0.02 in the
# vector), and both sides of half a turn.
ANGLES = [0.0, 1e-12, 1e-4, 9.9e-3, 1.01e-2, 1.99e-2, 2.01e-2, 0.7, 3.0, np.pi - 1e-7]


@pytest.mark.parametrize("angle", [*ANGLES, np.pi, 4.0, 6.0])
def test_matrix_is_that_of_scipy(angle):
    R = rotation_matrix(jnp.asarray(angle * AXIS))
    np.testing.assert_allclose(
        R, Rotation.from_rotvec(angle * AXIS).as_matrix(), rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("angle", ANGLES)
def test_vector_is_the_inverse(angle):
    w = angle * AXIS
    # Rounding of the matrix, 1e-16, and no more: not its root, as an arccos of the
    # trace would have at small angles and near half a turn.
    back = rotation_vector(rotation_matrix(jnp.asarray(w)))
    np.testing.assert_allclose(back, w, rtol=0, atol=2e-15)


@pytest.mark.parametrize("axis", [*np.eye(3), AXIS, -AXIS, [0.6, 0.8, 0.0]])
def test_half_a_turn(axis):
    """Both signs of the axis are the same rotation: either is right."""
    axis = np.asarray(axis)
    R = 2.0 * axis[:, None] * axis[None] - np.eye(3)
    w = np.asarray(rotation_vector(jnp.asarray(R)))
    np.testing.assert_allclose(w * np.sign(w @ axis), np.pi * axis, rtol=0, atol=1e-15)


@pytest.mark.parametrize("angle", [3.3, 5.0])
def test_more_than_half_a_turn_comes_back_the_short_way(angle):
    back = rotation_vector(rotation_matrix(jnp.asarray(angle * AXIS)))
    np.testing.assert_allclose(back, (angle - 2 * np.pi) * AXIS, rtol=0, atol=4e-15)


def test_derivatives_at_zero():
    """dR = hat(w), and back: no division by the angle remains."""
    w = jnp.array([0.3, -1.2, 0.7])
    _, dR = jax.jvp(rotation_matrix, (jnp.zeros(3),), (w,))
    np.testing.assert_allclose(dR @ AXIS, np.cross(w, AXIS), atol=1e-15)
    _, dw = jax.jvp(rotation_vector, (jnp.eye(3),), (dR,))
    np.testing.assert_allclose(dw, w, rtol=1e-15)


def through_matrix(w):
    """A smooth function of w by way of the matrix, with a vector that is not w."""
    return rotation_vector(rotation_matrix(w) @ rotation_matrix(jnp.asarray(AXIS)))


@pytest.mark.parametrize(
    "function", [rotation_matrix, through_matrix, lambda w: jnp.sin(through_matrix(w))]
)
@pytest.mark.parametrize("angle", [0.0, 5e-3, 1.5, 3.0])
def test_derivative_meets_differences_at_second_order(function, angle):
    function = jax.jit(function)
    w, tangent = angle * jnp.array([0.8, 0.0, -0.6]), jr.normal(jr.key(0), (3,))
    value, jvp = jax.jvp(function, (w,), (tangent,))
    assert_second_order(function, w, tangent, jvp, (3e-2, 3e-3), rtol=0.03)
    cotangent = jr.normal(jr.key(1), value.shape)
    reverse = jax.vjp(function, w)[1](cotangent)[0]
    # Reverse is the transpose of forward, so only rounding may separate them.
    np.testing.assert_allclose(
        jnp.vdot(cotangent, jvp), jnp.vdot(reverse, tangent), rtol=1e-12
    )
