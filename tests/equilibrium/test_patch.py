"""Fields that an element holds exactly come out exactly."""

import jax.numpy as jnp
import numpy as np
import pytest
from bodies import imposed_on, lane, solve, stiffness
from problems import boundary_nodes, irregular_cube

from softcal_jax.equilibrium import RESULTS, NewtonSettings, build_model, gravity_load
from softcal_jax.materials import NeoHookean

CASES = [(1, "displacement"), (2, "displacement"), (2, "mean-dilatation")]


def cube(order, formulation):
    return build_model(
        irregular_cube(3, order),
        NeoHookean(1000.0, 0.3),
        density=1.0,
        formulation=formulation,
    )


@pytest.mark.parametrize(("order", "formulation"), CASES)
def test_linear_displacement_is_reproduced(order, formulation):
    """Irregular mesh, large stretch, shear and turn imposed on the boundary."""
    model = cube(order, formulation)
    F = np.array([[1.3, 0.4, 0.0], [-0.2, 0.9, 0.1], [0.1, 0.0, 1.1]])
    exact = model.mesh.points @ (F - np.eye(3)).T
    held = boundary_nodes(model.mesh)
    assert len(held) < model.mesh.n_nodes
    lanes = imposed_on(model.mesh, held, exact)
    solution = lane(solve(model, lanes, NewtonSettings(rtol=1e-13)), 0)
    assert bool(solution.result == RESULTS.converged)
    # Rounding of the residual, 1e-13, times the condition of the inner stiffness.
    np.testing.assert_allclose(solution.displacement, exact, rtol=0, atol=1e-12)
    np.testing.assert_allclose(solution.min_det_F, np.linalg.det(F), rtol=1e-11)


def quadratic_patch_error(order, formulation):
    """Error relative to u = 1e-3 (x^2 + y z, x y - z^2, y^2 + x z), linear elasticity.

    The body force is -div sigma = 1000 (-6, 1, -1) / 1300 for E = 1000 and nu = 0.3;
    the tangent at rest is solved with LAPACK.
    """
    model = cube(order, formulation)
    x, y, z = model.mesh.points.T
    exact = 1e-3 * np.stack([x**2 + y * z, x * y - z**2, y**2 + x * z], axis=1)
    b = jnp.array([-4.615384615384615, 0.769230769230769, -0.769230769230769])
    K = stiffness(model, jnp.zeros(exact.shape))
    inner = np.ones(exact.shape, bool)
    inner[boundary_nodes(model.mesh)] = False
    inner = inner.ravel()
    load = (
        np.asarray(gravity_load(model, b)).ravel()
        - K[:, ~inner] @ exact[~inner.reshape(exact.shape)]
    )
    u = np.linalg.solve(K[np.ix_(inner, inner)], load[inner])
    gap = u - exact.ravel()[inner]
    return np.abs(gap).max() / np.abs(exact).max()


def test_quadratic_displacement_is_exact_on_quadratic_tets():
    assert quadratic_patch_error(2, "displacement") < 1e-12


@pytest.mark.parametrize(("order", "formulation"), [(1, "displacement"), CASES[2]])
def test_quadratic_displacement_is_not_in_the_other_elements(order, formulation):
    """Linear tets cannot hold it, nor one volume ratio per tet its divergence."""
    assert 1e-5 < quadratic_patch_error(order, formulation) < 0.1
