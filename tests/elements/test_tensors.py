import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from problems import assert_second_order
from scipy.spatial.transform import Rotation

from softcal_jax.elements import (
    axial,
    cofactor,
    determinant,
    matmul,
    rotation,
    skew,
    symmetric,
)

RANDOM = np.random.default_rng(0)
A, B = map(jnp.asarray, RANDOM.normal(size=(2, 3, 3)))
a, b = map(jnp.asarray, RANDOM.normal(size=(2, 3)))


def test_algebra_is_that_of_numpy():
    np.testing.assert_allclose(determinant(A), np.linalg.det(A), rtol=1e-13)
    np.testing.assert_allclose(
        cofactor(A), np.linalg.det(A) * np.linalg.inv(A).T, rtol=1e-12
    )
    np.testing.assert_allclose(matmul(A, B), A @ B, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(axial(skew(a)), 2.0 * a, rtol=1e-15)
    np.testing.assert_allclose(symmetric(A) + skew(axial(A)) / 2.0, A, rtol=1e-14)


def gradient_of_condition(condition, seed):
    """F = R S whose stretches span a condition number, and its rotation R."""
    rng = np.random.default_rng(seed)
    R, V = Rotation.random(2, rng).as_matrix()
    stretches = np.geomspace(1.0, 1.0 / condition, 3)
    return R @ (V * stretches) @ V.T, R


@pytest.mark.parametrize("condition", [1.0, 1e2, 1e4, 1e6, 1e8])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_rotation_of_badly_conditioned_gradients(condition, scale):
    """Newton's polar factor is orthogonal to rounding at any condition number.

    R itself is only defined to rounding over the sum of the two smallest stretches.
    """
    for seed in range(5):
        F, R = gradient_of_condition(condition, seed)
        ours = np.asarray(jax.jit(rotation)(scale * F))
        np.testing.assert_allclose(ours @ ours.T, np.eye(3), rtol=0, atol=1e-13)
        assert np.linalg.det(ours) > 0
        two_smallest = 1.0 / condition + 1.0 / np.sqrt(condition)
        tolerance = max(1e-13, 10.0 * np.finfo(float).eps / two_smallest)
        np.testing.assert_allclose(ours, R, rtol=0, atol=tolerance)
        reference, _ = scipy.linalg.polar(F)
        np.testing.assert_allclose(ours, reference, rtol=0, atol=2.0 * tolerance)


def test_rotation_at_large_random_deformation():
    """Where five unscaled Newton steps fail, against SciPy's polar decomposition."""
    F = np.eye(3) + 2.0 * np.random.default_rng(0).normal(size=(200, 3, 3))
    F = F[np.linalg.det(F) > 1e-2]
    assert len(F) > 50
    ours = jax.vmap(rotation)(jnp.asarray(F))
    reference = np.stack([scipy.linalg.polar(one)[0] for one in F])
    np.testing.assert_allclose(ours, reference, rtol=0, atol=1e-13)


def test_derivative_of_the_rotation():
    """Second order against differences; forward equals reverse near rounding."""
    F, _ = gradient_of_condition(10.0, 3)
    F, dF, cotangent = jnp.asarray(F), A, B
    _, jvp = jax.jvp(rotation, (F,), (dF,))
    assert_second_order(rotation, F, dF, jvp, (1e-3, 1e-4), rtol=0.02)
    _, vjp = jax.vjp(rotation, F)
    np.testing.assert_allclose(
        jnp.vdot(cotangent, jvp), jnp.vdot(vjp(cotangent)[0], dF), rtol=1e-12
    )


def test_a_turn_of_the_body_turns_the_rotation_at_the_same_rate():
    """A pure turn of the body, dF = hat(w) F, has dR = hat(w) R."""
    F, R = map(jnp.asarray, gradient_of_condition(5.0, 1))
    _, dR = jax.jvp(rotation, (F,), (skew(a) @ F,))
    np.testing.assert_allclose(dR, skew(a) @ R, rtol=1e-12, atol=1e-12)
