"""The corotational law with a fibre, and the classical form without hat(c)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laws import CLASSICAL, ELASTICITIES, GRADIENTS, at, energy, stress, tangent
from problems import central_difference
from scipy.linalg import polar, solve_sylvester
from scipy.spatial.transform import Rotation

from softcal_jax.materials import Corotational

each_elasticity = pytest.mark.parametrize(
    "elasticity", ELASTICITIES.values(), ids=ELASTICITIES
)
each_classical = pytest.mark.parametrize("law", CLASSICAL.values(), ids=CLASSICAL)


stress_at = jax.jit(lambda elasticity, strain: elasticity.stress(strain))


@each_elasticity
def test_second_derivation(elasticity):
    """P = 2 F X with S X + X S = sigma, from psi as a function of F^T F."""
    for F in GRADIENTS:
        _, S = polar(F)
        sigma = np.asarray(stress_at(elasticity, S - np.eye(3)))
        P = 2 * F @ solve_sylvester(S, S, sigma)
        ours = stress(Corotational(elasticity), F)
        np.testing.assert_allclose(ours, P, rtol=0, atol=1e-13)


@each_elasticity
def test_derivative_in_the_constants(elasticity):
    """dP/dp at fixed F: against differences of second order, leaf by leaf."""
    law, F = Corotational(elasticity), jnp.asarray(GRADIENTS[3])
    leaves, structure = jax.tree.flatten(law)
    assert len(leaves) in (5, 7)
    P = jax.jit(lambda leaves: jax.tree.unflatten(structure, leaves).stress(F))
    leaves = [np.asarray(leaf) for leaf in leaves]
    slopes = jax.tree.map(np.asarray, jax.jit(jax.jacfwd(P))(leaves))
    value = lambda leaves: np.asarray(P(leaves))
    for k, slope in enumerate(slopes):
        direction = [np.asarray(float(k == i)) for i in range(len(leaves))]
        assert np.max(np.abs(slope)) > 1e-3  # a forgotten constant would give zero
        error = lambda h, d=direction, slope=slope: np.max(
            np.abs(central_difference(value, leaves, d, h) - slope)
        )
        if error(1e-2) > 1e-11:  # differences of a linear dependence are exact
            np.testing.assert_allclose(error(1e-2) / error(1e-3), 100.0, rtol=0.05)


@each_elasticity
def test_derivative_in_theta(elasticity):
    """At a fixed strain d sigma / d theta follows from turning the axes about n.

    sigma(theta + t) = Q sigma(Q^T strain Q) Q^T with Q = exp(t hat(n)), n the normal of
    the plane in which theta counts and phi stands: z for "xy".
    """
    strain = jnp.asarray([[0.3, -0.1, 0.2], [-0.1, 0.5, 0.4], [0.2, 0.4, -0.6]])
    n = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    at = lambda theta: eqx.tree_at(lambda e: e.fibre.theta, elasticity, theta)
    slope = jax.jit(jax.jacfwd(lambda theta: at(theta).stress(strain)))(0.4)
    sigma = np.asarray(stress_at(elasticity, strain))
    inner = np.asarray(stress_at(elasticity, strain @ n - n @ strain))
    np.testing.assert_allclose(slope, n @ sigma - sigma @ n + inner, rtol=0, atol=1e-14)


@each_classical
def test_classical_form_is_rotation_times_stress(law):
    for F in GRADIENTS:
        R, S = polar(F)
        P = R @ np.asarray(stress_at(law.elasticity, S - np.eye(3)))
        np.testing.assert_allclose(stress(law, F), P, rtol=0, atol=1e-13)
        exact = energy(Corotational(law.elasticity), F)
        np.testing.assert_allclose(energy(law, F), exact, rtol=1e-14)


@each_classical
def test_classical_form_is_objective(law):
    for seed, F in enumerate(GRADIENTS):
        Q = Rotation.random(rng=seed).as_matrix()
        np.testing.assert_allclose(
            stress(law, Q @ F), Q @ stress(law, F), rtol=0, atol=1e-13
        )


@each_classical
def test_classical_tangent_is_the_derivative_of_its_stress(law):
    derived = jax.jit(lambda law, F: jax.jacfwd(law.stress)(F))
    for F in GRADIENTS:
        np.testing.assert_allclose(tangent(law, F), derived(law, F), rtol=0, atol=1e-12)


def classical_defects(law):
    """Skew part of P F^T over its size, of the tangent over its size; worst state."""
    moments, asymmetries = [], []
    for F in GRADIENTS:
        _, P, A = at(law, F)
        kirchhoff = P @ F.T
        norm = np.linalg.norm
        moments.append(norm(kirchhoff - kirchhoff.T) / norm(kirchhoff))
        asymmetries.append(norm(A - A.transpose(2, 3, 0, 1)) / norm(A))
    return max(moments), max(asymmetries)


def test_classical_form_of_an_isotropic_law_is_the_exact_one():
    assert max(classical_defects(CLASSICAL["isotropic"])) < 1e-14
    exact = Corotational(CLASSICAL["isotropic"].elasticity)
    for F in GRADIENTS:
        np.testing.assert_allclose(
            stress(CLASSICAL["isotropic"], F), stress(exact, F), rtol=0, atol=1e-14
        )
        np.testing.assert_allclose(
            tangent(CLASSICAL["isotropic"], F), tangent(exact, F), rtol=0, atol=1e-14
        )


@pytest.mark.parametrize("name", ELASTICITIES)
def test_classical_form_with_a_fibre_has_no_potential(name):
    """Moments do not balance, the tangent is not symmetric, and it says so."""
    law = CLASSICAL[name]
    assert not law.conservative
    moment, asymmetry = classical_defects(law)
    assert moment > 0.05
    assert asymmetry > 0.05
    assert max(classical_defects(Corotational(law.elasticity))) < 1e-14
