"""Energy, force and stiffness belong together; rigid motions cost nothing."""

import jax.numpy as jnp
import numpy as np
import pytest
from bodies import energy, energy_gradient, force, force_jacobian, stiffness
from problems import irregular_cube
from scipy.spatial.transform import Rotation

from softcal_jax.equilibrium import build_model, internal_force
from softcal_jax.materials import Corotational, Isotropic, NeoHookean

CASES = [(1, "displacement"), (2, "displacement"), (2, "mean-dilatation")]


@pytest.fixture(
    scope="module", params=CASES, ids=lambda case: f"tet{case[0]}-{case[1]}"
)
def body(request):
    """48 irregular tets, each with constants of its own."""
    order, formulation = request.param
    E = np.random.default_rng(0).permutation(np.linspace(0.5, 1.2, 48))
    law = NeoHookean(E, np.linspace(0.2, 0.4, 48))
    mesh = irregular_cube(2, order)
    return build_model(mesh, law, density=1.0, formulation=formulation)


@pytest.fixture(scope="module")
def u(body):
    """A large smooth displacement and a small rough one, det F > 0."""
    X = body.mesh.points
    rough = np.random.default_rng(0).normal(size=X.shape)
    bend = np.stack([X[:, 2] ** 2, X[:, 0] * X[:, 1], X[:, 0] ** 2], axis=1)
    return jnp.asarray(0.2 * bend + 0.01 * rough)


def test_force_is_the_gradient_of_the_energy(body, u):
    f = force(body, u)
    assert jnp.max(jnp.abs(f)) > 0.01
    # Sums over the tets around a node, of stresses of order one.
    np.testing.assert_allclose(f, energy_gradient(body, u), rtol=0, atol=1e-14)


def test_tangent_is_the_jacobian_of_the_force_and_symmetric(body, u):
    jacobian = np.asarray(force_jacobian(body, u)).reshape(body.n_dof, body.n_dof)
    scale = np.abs(jacobian).max()
    np.testing.assert_allclose(jacobian, jacobian.T, rtol=0, atol=1e-14 * scale)
    np.testing.assert_allclose(stiffness(body, u), jacobian, rtol=0, atol=1e-14 * scale)


def test_rigid_motion_has_no_energy_and_no_force(body):
    X = body.mesh.points
    Q, t = Rotation.random(rng=0).as_matrix(), np.array([3.0, -2.0, 1.0])
    moved = jnp.asarray(X @ Q.T + t - X)
    # Rounding of displacements of a few metres over tets of 1/2 m, modulus 1 Pa.
    np.testing.assert_allclose(force(body, moved), 0.0, atol=1e-14)
    np.testing.assert_allclose(energy(body, moved), 0.0, atol=1e-14)


def test_force_turns_with_the_body(body, u):
    X = body.mesh.points
    Q = Rotation.random(rng=1).as_matrix()
    turned = jnp.asarray((X + u) @ Q.T - X)
    np.testing.assert_allclose(
        force(body, turned), force(body, u) @ Q.T, rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(energy(body, turned), energy(body, u), rtol=1e-12)


def test_six_zero_eigenvalues(body):
    """A free body at rest: six rigid motions, and nothing else without stiffness."""
    values = np.linalg.eigvalsh(stiffness(body, jnp.zeros(body.mesh.points.shape)))
    assert np.abs(values[:6]).max() < 1e-13 * values[-1]
    assert values[6] > 1e-4 * values[-1]


def test_resultants_of_internal_forces_vanish(body, u):
    """No total force and no total moment about the origin, at any displacement."""
    f, x = np.asarray(force(body, u)), body.mesh.points + np.asarray(u)
    np.testing.assert_allclose(f.sum(axis=0), 0.0, atol=1e-14)
    np.testing.assert_allclose(np.cross(x, f).sum(axis=0), 0.0, atol=1e-14)


def test_padding_of_the_last_block_counts_nothing():
    """One tet alone in a block: energy = volume times psi of its homogeneous F."""
    mesh = irregular_cube(1, 1)
    law = Corotational(Isotropic(1.0, 0.25))
    body = build_model(mesh, law, density=1.0)
    stretched = jnp.asarray(mesh.points * np.array([0.1, 0.0, 0.0]))
    # lambda = mu = 0.4: psi = (lambda + 2 mu) / 2 * 0.1^2.
    np.testing.assert_allclose(energy(body, stretched), 0.006, rtol=1e-12)


def test_both_formulations_agree_where_the_volume_ratio_is_uniform():
    """And on linear tets always, since they have one point."""
    for order, rough in ((1, 0.05), (2, 0.0)):
        mesh = irregular_cube(2, order)
        F = np.array([[1.2, 0.1, 0.0], [0.0, 0.9, 0.2], [0.1, 0.0, 1.1]])
        noise = np.random.default_rng(0).normal(size=mesh.points.shape)
        u = jnp.asarray(mesh.points @ (F - np.eye(3)).T + rough * noise)
        law = NeoHookean(1.0, np.full(48, 0.3))
        a, b = (
            force(build_model(mesh, law, density=1.0, formulation=formulation), u)
            for formulation in ("displacement", "mean-dilatation")
        )
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-14)


def test_auto_takes_the_mixed_element_for_nearly_incompressible_quadratic_tets():
    picked = lambda order, nu: (
        build_model(
            irregular_cube(1, order), NeoHookean(1.0, nu), density=1.0
        ).formulation
    )
    assert picked(2, 0.499) == picked(2, 0.49) == "mean-dilatation"
    assert picked(2, 0.48) == picked(1, 0.499) == "displacement"


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("wrong", [lambda u: u[1:], lambda u: u[:, :2]])
def test_displacements_of_another_mesh_are_refused(body, u, wrong):
    """JAX would read the last node in place of one that is missing."""
    with pytest.raises(ValueError, match=rf"expected \({body.n_points}, 3\)"):
        internal_force(body, wrong(u))
