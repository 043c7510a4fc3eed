"""Bodies of SOFA's tets, against the same forces in NumPy and a known tip."""

import jax.numpy as jnp
import numpy as np
import pytest
import sofa_tets
from bodies import TIGHT, force_jacobian, solve, stiffness

from softcal_jax.configurations import Configuration, configuration_arrays
from softcal_jax.equilibrium import build_model, model_for_law
from softcal_jax.materials import Corotational, Isotropic, SofaCorotational
from softcal_jax.mesh import beam

E, NU, DENSITY, GRAVITY = 3e5, 0.4, 1070.0, (0.0, 0.0, -9.81)
SMALL = beam(0.1, 0.02, 0.02, (6, 2, 2))
HANGING = Configuration("hanging", "x_min", GRAVITY)


def solved(mesh, law):
    """Displacements under own weight [m]."""
    model = build_model(mesh, law, density=DENSITY)
    found = solve(model, configuration_arrays(mesh, [HANGING]), TIGHT)
    assert bool(found.converged[0])
    return np.asarray(found.displacement[0])


def of_numpy(mesh, kind, E=E):
    pieces = [sofa_tets.tets(mesh.points, mesh.tets, sofa_tets.hooke(E, NU), kind)]
    masses = DENSITY * sofa_tets.lumped_volumes(mesh.points, mesh.tets)
    load, free = masses[:, None] * np.array(GRAVITY), np.ones(mesh.points.shape, bool)
    free[mesh.points[:, 0] == 0.0] = False
    return sofa_tets.equilibrium(mesh.points, pieces, load, free) - mesh.points


@pytest.mark.parametrize(
    "kind",
    [
        "edge",
        pytest.param("procrustes", marks=pytest.mark.slow),
        pytest.param("large", marks=pytest.mark.slow),
    ],
)
def test_a_hanging_beam_with_moduli_per_tet(kind):
    """The weight of a tet on its nodes is a quarter each, as lumped by SOFA."""
    moduli = E * np.linspace(0.5, 1.5, SMALL.n_tets)
    law = SofaCorotational.of_mesh(SMALL, Isotropic(moduli, NU), kind)
    ours, theirs = solved(SMALL, law), of_numpy(SMALL, kind, moduli)
    motion = np.abs(theirs).max()
    assert motion > 2e-3
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-8 * motion)


def test_the_assembled_tangent_is_the_jacobian_of_the_force():
    law = SofaCorotational.of_mesh(SMALL, Isotropic(E, NU), "edge")
    made_for_another = build_model(SMALL, Corotational(Isotropic(E, NU)), density=1.0)
    model = model_for_law(made_for_another, law)
    x, y, _ = SMALL.points.T
    u = jnp.asarray(np.stack([-8.0 * x * y, 4.0 * x**2, 0.05 * x], axis=1))
    K = stiffness(model, u)
    exact = np.asarray(force_jacobian(model, u)).reshape(K.shape)
    np.testing.assert_allclose(K, exact, rtol=0, atol=1e-12 * np.abs(K).max())
    assert np.linalg.norm(K - K.T) > 1e-3 * np.linalg.norm(K)
