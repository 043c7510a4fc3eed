"""Constants of a law that differ from tet to tet."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import energy_gradient, force, force_jacobian, stiffness
from problems import irregular_cube

from softcal_jax.elements import shape_gradients
from softcal_jax.equilibrium import build_model
from softcal_jax.materials import (
    Corotational,
    Fibre,
    NeoHookean,
    ReducedTransverseIsotropic,
)

N_TETS = 6
FORMULATIONS = ["displacement", "mean-dilatation"]


def cube(order=2):
    return irregular_cube(1, order)


def anisotropic(E_t, theta):
    return Corotational(ReducedTransverseIsotropic(E_t, 0.4, 0.3, Fibre(theta)))


def per_tet(low, high):
    """Another value in every tet, in no order."""
    return np.random.default_rng(0).permutation(np.linspace(low, high, N_TETS))


def bent(mesh):
    X = mesh.points
    rough = np.random.default_rng(1).normal(size=X.shape)
    bend = np.stack([X[:, 2] ** 2, X[:, 0] * X[:, 1], X[:, 0] ** 2], axis=1)
    return jnp.asarray(0.2 * bend + 0.01 * rough)


def force_by_hand(mesh, u, law_of):
    """Sum of w P : dN over the tets and their points, in ordinary loops.

    The degree-2 rule and the map to the tet are written out; the stress is that of
    a law with plain numbers.
    """
    a, b = (5.0 - 5.0**0.5) / 20.0, (5.0 + 3.0 * 5.0**0.5) / 20.0
    reference = shape_gradients(np.full((4, 4), a) + (b - a) * np.eye(4), 10)
    total = np.zeros(mesh.points.shape)
    for t, nodes in enumerate(mesh.tets):
        X, x = mesh.points[nodes], (mesh.points + np.asarray(u))[nodes]
        for q in range(4):
            jacobian = X.T @ reference[q]
            dN = reference[q] @ np.linalg.inv(jacobian)
            P = stress(law_of(t), jnp.asarray(x.T @ dN))
            total[nodes] += np.linalg.det(jacobian) / 24.0 * dN @ np.asarray(P).T
    return total


stress = jax.jit(lambda law, F: law.stress(F))


def test_force_is_the_sum_over_points_with_the_constants_of_their_tet():
    mesh = cube()
    u = bent(mesh)
    E_t, theta = per_tet(0.5, 3.0), per_tet(-1.5, 1.5)[::-1]
    body = build_model(mesh, anisotropic(E_t, theta), density=1.0)
    by_hand = force_by_hand(mesh, u, lambda t: anisotropic(E_t[t], theta[t]))
    assert np.abs(by_hand).max() > 1e-3
    np.testing.assert_allclose(force(body, u), by_hand, rtol=0, atol=1e-14)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_force_and_tangent_are_derivatives_of_the_energy(formulation):
    mesh = cube()
    u = bent(mesh)
    law = NeoHookean(per_tet(0.5, 3.0), per_tet(0.1, 0.4)[::-1])
    body = build_model(mesh, law, density=1.0, formulation=formulation)
    np.testing.assert_allclose(
        force(body, u), energy_gradient(body, u), rtol=0, atol=1e-14
    )
    jacobian = np.asarray(force_jacobian(body, u)).reshape(body.n_dof, body.n_dof)
    scale = np.abs(jacobian).max()
    np.testing.assert_allclose(stiffness(body, u), jacobian, rtol=0, atol=1e-13 * scale)


@pytest.mark.parametrize("order", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_tabulated_law_has_its_entries_where_the_constants_are(order):
    """One for all, one per tet, and both in one law."""
    mesh = cube(order)
    u, E_t, theta = bent(mesh), per_tet(0.8, 1.3), per_tet(0.2, 1.0)
    for constants in [(1.0, 0.3), (E_t, 0.3), (1.0, theta), (E_t, theta)]:
        model = build_model(mesh, anisotropic(*constants), density=1.0)
        table = model.tabulated()
        shape = jax.tree.leaves(table.law)[0].shape
        assert shape == np.broadcast_shapes(*map(np.shape, constants))
        scale = float(jnp.max(jnp.abs(force(model, u))))
        np.testing.assert_allclose(
            force(table, u), force(model, u), rtol=0, atol=1e-13 * scale
        )
        K = stiffness(model, u)
        np.testing.assert_allclose(
            stiffness(table, u), K, rtol=0, atol=1e-13 * np.max(np.abs(K))
        )
