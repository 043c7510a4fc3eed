"""Constants of a law that differ between the quadrature points of a tet."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import energy, energy_gradient, force, force_jacobian, stiffness
from problems import irregular_cube

from softcal_jax.elements import shape_gradients
from softcal_jax.equilibrium import build_model
from softcal_jax.materials import (
    Corotational,
    Fibre,
    NeoHookean,
    PointValues,
    ReducedTransverseIsotropic,
)
from softcal_jax.mesh import beam

N_TETS = 6
FORMULATIONS = ["displacement", "mean-dilatation"]


def cube(order=2):
    return irregular_cube(1, order)


def anisotropic(E_t, theta):
    return Corotational(ReducedTransverseIsotropic(E_t, 0.4, 0.3, Fibre(theta)))


def at_points(low, high, n_qp=4):
    """Another value in every point, in no order."""
    values = np.linspace(low, high, N_TETS * n_qp)
    return np.random.default_rng(0).permutation(values).reshape(N_TETS, n_qp)


def bent(mesh):
    X = mesh.points
    rough = np.random.default_rng(1).normal(size=X.shape)
    bend = np.stack([X[:, 2] ** 2, X[:, 0] * X[:, 1], X[:, 0] ** 2], axis=1)
    return jnp.asarray(0.2 * bend + 0.01 * rough)


def force_by_hand(mesh, u, law_at):
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
            P = stress(law_at(t, q), jnp.asarray(x.T @ dN))
            total[nodes] += np.linalg.det(jacobian) / 24.0 * dN @ np.asarray(P).T
    return total


stress = jax.jit(lambda law, F: law.stress(F))


def test_force_is_the_sum_over_points_with_constants_of_their_own():
    mesh = cube()
    u = bent(mesh)
    E_t, theta = at_points(0.5, 3.0), at_points(-1.5, 1.5)[::-1]
    law = anisotropic(1.0, 0.0)
    body = build_model(mesh, law, density=1.0)
    where = lambda law: (law.elasticity.E_t, law.elasticity.fibre.theta)
    values = (PointValues(jnp.asarray(E_t)), PointValues(jnp.asarray(theta)))
    body = body.with_law(_replaced(law, where, values))
    by_hand = force_by_hand(mesh, u, lambda t, q: anisotropic(E_t[t, q], theta[t, q]))
    assert np.abs(by_hand).max() > 1e-3
    np.testing.assert_allclose(force(body, u), by_hand, rtol=0, atol=1e-14)
    # The mean of each tet is another body.
    mean = build_model(
        mesh, anisotropic(E_t.mean(axis=1), theta.mean(axis=1)), density=1.0
    )
    gap = np.abs(np.asarray(force(mean, u)) - by_hand).max()
    assert gap > 0.05 * np.abs(by_hand).max()


def _replaced(law, where, values):
    return eqx.tree_at(where, law, values)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("order", [1, 2])
def test_equal_values_are_a_constant(formulation, order):
    mesh = cube(order)
    u = bent(mesh)
    n_qp = 1 if order == 1 else 4
    per_tet = np.linspace(0.5, 3.0, N_TETS)
    plain = build_model(
        mesh, NeoHookean(per_tet, 0.3), density=1.0, formulation=formulation
    )
    points = PointValues(jnp.asarray(np.repeat(per_tet[:, None], n_qp, axis=1)))
    body = plain.with_law(_replaced(plain.law, lambda law: law.E, points))
    for function in (energy, force, stiffness):
        np.testing.assert_allclose(
            function(body, u), function(plain, u), rtol=1e-13, atol=1e-15
        )


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_force_and_tangent_are_derivatives_of_the_energy(formulation):
    mesh = cube()
    u = bent(mesh)
    plain = build_model(
        mesh, NeoHookean(1.0, 0.3), density=1.0, formulation=formulation
    )
    points = (
        PointValues(jnp.asarray(at_points(0.5, 3.0))),
        PointValues(jnp.asarray(at_points(0.1, 0.4))),
    )
    body = plain.with_law(_replaced(plain.law, lambda law: (law.E, law.nu), points))
    assert np.abs(force(body, u) - force(plain, u)).max() > 1e-3
    np.testing.assert_allclose(
        force(body, u), energy_gradient(body, u), rtol=0, atol=1e-14
    )
    jacobian = np.asarray(force_jacobian(body, u)).reshape(body.n_dof, body.n_dof)
    scale = np.abs(jacobian).max()
    np.testing.assert_allclose(stiffness(body, u), jacobian, rtol=0, atol=1e-13 * scale)


def test_points_of_another_number_of_tets_are_refused():
    body = build_model(
        beam(1.0, 1.0, 1.0, (1, 1, 1)), NeoHookean(1.0, 0.3), density=1.0
    )
    short = _replaced(body.law, lambda law: law.E, PointValues(jnp.ones((5, 1))))
    with pytest.raises(ValueError, match=r"law.E.values has shape \(5, 1\).* 6 tets"):
        body.with_law(short)


@pytest.mark.parametrize("order", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_tabulated_law_has_its_entries_where_the_constants_are(order):
    """One for all, one per tet, one per point, and all three in one law."""
    mesh = cube(order)
    u, n_qp = bent(mesh), 4 if order == 2 else 1
    per_tet = np.linspace(0.8, 1.3, N_TETS)
    per_point = PointValues(jnp.asarray(at_points(0.2, 1.0, n_qp)))
    for E_t, theta in [
        (1.0, 0.3),
        (per_tet, 0.3),
        (1.0, per_point),
        (per_tet, per_point),
    ]:
        law = eqx.tree_at(
            lambda law: law.elasticity.fibre.theta,
            anisotropic(E_t, 0.3),
            jax.tree.map(jnp.asarray, theta),
        )
        model = build_model(mesh, law, density=1.0)
        table = model.tabulated()
        shape = jax.tree.leaves(table.law)[0].shape
        assert shape == np.broadcast_shapes(
            np.shape(E_t), np.shape(getattr(theta, "values", theta))[:1]
        ) + ((n_qp,) if isinstance(theta, PointValues) else ())
        scale = float(jnp.max(jnp.abs(force(model, u))))
        np.testing.assert_allclose(
            force(table, u), force(model, u), rtol=0, atol=1e-13 * scale
        )
        K = stiffness(model, u)
        np.testing.assert_allclose(
            stiffness(table, u), K, rtol=0, atol=1e-13 * np.max(np.abs(K))
        )
