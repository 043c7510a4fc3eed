"""Energy, stress and tangent of a law belong together, whatever the law."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from laws import (
    GRADIENTS,
    LAM,
    LAWS,
    MU,
    derived_stress,
    energy,
    hessian,
    stress,
    tangent,
)
from problems import central_difference
from scipy.spatial.transform import Rotation

each_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


def test_the_states_are_far_from_rest_and_not_inverted():
    stretches = jnp.linalg.svd(GRADIENTS, compute_uv=False)
    assert jnp.all(jnp.linalg.det(GRADIENTS) > 0.1)
    assert stretches.max() > 1.5
    assert stretches.min() < 0.6


@each_law
def test_stress_is_the_derivative_of_the_energy(law):
    """Differences of the energy meet the stress at second order."""
    F, dF = GRADIENTS[0], jr.normal(jr.key(1), (3, 3))
    power = jnp.vdot(stress(law, F), dF)
    psi = lambda F: energy(law, F)
    error = lambda h: abs(central_difference(psi, F, dF, h) - power)
    # Second order: a tenfold smaller step leaves a hundredth of the error.
    np.testing.assert_allclose(error(1e-2) / error(1e-3), 100.0, rtol=0.02)


@each_law
def test_tangent_is_the_derivative_of_the_stress(law):
    F, dF = GRADIENTS[1], jr.normal(jr.key(2), (3, 3))
    dP = jnp.tensordot(tangent(law, F), dF, 2)
    P = lambda F: stress(law, F)
    error = lambda h: jnp.max(jnp.abs(central_difference(P, F, dF, h) - dP))
    # Second order: a tenfold smaller step leaves a hundredth of the error.
    np.testing.assert_allclose(error(1e-2) / error(1e-3), 100.0, rtol=0.05)


@each_law
def test_closed_forms_equal_automatic_differentiation(law):
    """What a law overrides against what `AbstractLaw` derives from its energy."""
    for F in GRADIENTS:
        np.testing.assert_allclose(
            stress(law, F), derived_stress(law, F), rtol=0, atol=1e-13
        )
        np.testing.assert_allclose(tangent(law, F), hessian(law, F), rtol=0, atol=1e-12)


@each_law
def test_objectivity(law):
    """psi(Q F) = psi(F) and P(Q F) = Q P(F) for a rotation Q of the observer."""
    for seed, F in enumerate(GRADIENTS):
        Q = jnp.asarray(Rotation.random(rng=seed).as_matrix())
        np.testing.assert_allclose(energy(law, Q @ F), energy(law, F), rtol=1e-12)
        np.testing.assert_allclose(
            stress(law, Q @ F), Q @ stress(law, F), rtol=0, atol=1e-13
        )


@each_law
def test_isotropy(law):
    """psi(F Q) = psi(F) for a rotation Q of the rest shape."""
    Q = jnp.asarray(Rotation.random(rng=1).as_matrix())
    for F in GRADIENTS:
        np.testing.assert_allclose(energy(law, F @ Q), energy(law, F), rtol=1e-12)


@each_law
def test_symmetries(law):
    """Balance of moments, P F^T symmetric, and major symmetry of the tangent."""
    for F in GRADIENTS:
        kirchhoff = stress(law, F) @ F.T
        np.testing.assert_allclose(kirchhoff, kirchhoff.T, rtol=0, atol=1e-13)
        A = tangent(law, F)
        np.testing.assert_allclose(A, A.transpose(2, 3, 0, 1), rtol=0, atol=1e-12)


@each_law
def test_rest_and_linear_limit(law):
    """No stress at rest, also turned; the tangent there is Hooke's tensor."""
    Q = jnp.asarray(Rotation.random(rng=2).as_matrix())
    for F in (jnp.eye(3), Q):
        # A few roundings of the moduli, which are of order one.
        np.testing.assert_allclose(stress(law, F), 0.0, atol=1e-14)
        np.testing.assert_allclose(energy(law, F), 0.0, atol=1e-14)
    d = np.eye(3)
    hooke = (
        LAM * np.einsum("ij,kl->ijkl", d, d)
        + MU * np.einsum("ik,jl->ijkl", d, d)
        + MU * np.einsum("il,jk->ijkl", d, d)
    )
    np.testing.assert_allclose(tangent(law, jnp.eye(3)), hooke, rtol=0, atol=1e-14)


@each_law
def test_forward_equals_reverse(law):
    F, dF, cotangent = GRADIENTS[2], *jr.normal(jr.key(3), (2, 3, 3))
    _, jvp = jax.jvp(lambda F: stress(law, F), (F,), (dF,))
    _, vjp = jax.vjp(lambda F: stress(law, F), F)
    np.testing.assert_allclose(
        jnp.vdot(cotangent, jvp), jnp.vdot(vjp(cotangent)[0], dF), rtol=1e-12
    )
