"""The path of a held pose against a rod of constant curvature."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from softcal_jax.bodies import winding

LENGTH = 0.1
ARM = jnp.array([LENGTH, 0.0, 0.0])


def arc(angle):
    """End of a rod along x of constant length, bent towards z by an angle."""
    return LENGTH * np.array([np.sin(angle), 0.0, 1.0 - np.cos(angle)]) / angle


@pytest.mark.parametrize("angle", [1e-3, 0.5 * np.pi, np.pi, 1.5 * np.pi, 2.0 * np.pi])
def test_a_bent_rod_keeps_its_length(angle):
    """On its way to any part of a circle, a whole one included."""
    translation = jnp.asarray(arc(angle)) - ARM
    rotation = jnp.array([0.0, -angle, 0.0])
    for load in (0.1, 0.5, 0.9):
        off = winding(ARM, translation, rotation, jnp.asarray(load))
        there = np.asarray(ARM + load * translation + off)
        np.testing.assert_allclose(there, arc(load * angle), rtol=0, atol=1e-12)


def test_it_is_the_exponential_of_a_twist_that_grows_with_the_load():
    """In space: curved, twisted and stretched rods, by the exponential of SciPy."""
    for key in jr.split(jr.key(3), 4):
        w, e = np.array(jr.normal(key, (2, 3)))

        def end(load, w=w, e=e):
            twist = np.zeros((4, 4))
            twist[:3, :3] = np.cross(load * w, np.eye(3)).T
            twist[:3, 3] = (1.0 - load) * np.asarray(ARM) + load * e
            return expm(twist)

        np.testing.assert_allclose(
            end(1.0)[:3, :3], Rotation.from_rotvec(w).as_matrix(), atol=1e-12
        )
        translation = jnp.asarray(end(1.0)[:3, 3]) - ARM
        for load in (0.3, 0.8):
            off = winding(ARM, translation, jnp.asarray(w), jnp.asarray(load))
            there = np.asarray(ARM + load * translation + off)
            # The bounded inverse is off by WIND^2 of the motion, less than a full turn.
            np.testing.assert_allclose(there, end(load)[:3, 3], atol=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_both_ends_are_those_of_a_straight_line_and_so_are_their_derivatives(seed):
    arm, translation, rotation = 3.0 * jr.normal(jr.key(seed), (3, 3))
    for load in (jnp.asarray(0.0), jnp.asarray(1.0)):
        off = winding(arm, translation, rotation, load)
        np.testing.assert_allclose(off, 0.0, rtol=0, atol=1e-14)
        slopes = jax.jacrev(winding, (0, 1, 2))(arm, translation, rotation, load)
        for slope in slopes:
            np.testing.assert_array_equal(slope, 0.0)


def test_a_hinge_stays_where_it_is():
    """Without an arm a pure rotation is about the origin of the body."""
    none, w = jnp.zeros(3), jnp.array([0.3, -2.0, 1.0])
    off = winding(none, none, w, jnp.asarray(0.4))
    np.testing.assert_array_equal(off, 0.0)
