"""Bodies of SOFA's tets, against the same forces in NumPy and a known tip."""

from itertools import permutations

import jax.numpy as jnp
import numpy as np
import pytest
import sofa_tets
from bodies import TIGHT, force_jacobian, solve, stiffness
from problems import nearest_node

from softcal_jax.configurations import Configuration, configuration_arrays
from softcal_jax.equilibrium import build_model, model_for_law
from softcal_jax.materials import Corotational, Isotropic, SofaCorotational
from softcal_jax.mesh import TetMesh, beam

E, NU, DENSITY, GRAVITY = 3e5, 0.4, 1070.0, (0.0, 0.0, -9.81)
SMALL = beam(0.1, 0.02, 0.02, (6, 2, 2))
HANGING = Configuration("hanging", "x_min", GRAVITY)


# Displacement of the centre of the end face of the beam with 20 x 4 x 4 cells, each cut
# into Kuhn's six tets, all alike, by the forces of `TetrahedronFEMForceField` with the
# method "polar" [mm]: a reference computed elsewhere, by none of the codes here.
SOFA_TIP = (-0.49869, 1.01582, -9.38902)


def kuhn_beam(cells):
    """The beam with each cell cut along the same diagonal; the package mirrors cuts."""
    counts = np.array(cells)
    corner = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1)
    tets = []
    for order in permutations(np.eye(3, dtype=int)):
        path = np.cumsum([np.zeros(3, int), *order], axis=0)
        if np.linalg.det(path[1:]) < 0:
            path = path[[0, 1, 3, 2]]
        tets.append(corner[..., None, :] + path)
    nodes = np.stack(tets, axis=3).reshape(-1, 4, 3)
    index = np.ravel_multi_index(tuple(np.moveaxis(nodes, -1, 0)), counts + 1)
    lattice = np.indices(counts + 1).reshape(3, -1).T
    points = lattice / counts * (0.1, 0.02, 0.02)
    return TetMesh(points, index, {"x_min": np.flatnonzero(lattice[:, 0] == 0)})


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


@pytest.mark.slow
@pytest.mark.parametrize("in_numpy", [True, False], ids=["NumPy", "package"])
def test_the_tip_of_a_beam_of_the_method_polar(in_numpy):
    """To the 1e-5 mm that it is known to; the rotation of polar(F) is 0.06 mm off."""
    mesh = kuhn_beam((20, 4, 4))
    tip = nearest_node(mesh, (0.1, 0.01, 0.01))
    if in_numpy:
        u = of_numpy(mesh, "edge")
    else:
        u = solved(mesh, SofaCorotational.of_mesh(mesh, Isotropic(E, NU), "edge"))
    np.testing.assert_allclose(1e3 * u[tip], SOFA_TIP, rtol=0, atol=1e-5)


@pytest.mark.slow
def test_the_rotation_of_the_law_without_edges_is_another():
    mesh = kuhn_beam((20, 4, 4))
    tip = nearest_node(mesh, (0.1, 0.01, 0.01))
    off = 1e3 * solved(mesh, Corotational(Isotropic(E, NU)))[tip] - SOFA_TIP
    # Measured 0.7 % along the load, 7 % sideways.
    np.testing.assert_allclose(off / SOFA_TIP, [0.0141, -0.0701, 0.0073], atol=1e-4)


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
