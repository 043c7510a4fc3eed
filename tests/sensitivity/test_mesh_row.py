"""The row of the error of the mesh, and the stresses that it is made of."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import lane_of

from softcal_jax.configurations import Configuration, SurfaceForce, configuration_arrays
from softcal_jax.equilibrium import (
    build_model,
    force_of_gradients,
    internal_force,
    linearise,
    tet_stresses,
)
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.sensitivity import _rows, stress_patches

# 18 tets: the last block of 16 is padded.
each_element = pytest.mark.parametrize(
    ("order", "formulation"),
    [(1, "displacement"), (2, "displacement"), (2, "mean-dilatation")],
)


def deformed(order, formulation="displacement"):
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1), order=order)
    law = NeoHookean(2e5, 0.3)
    model = build_model(mesh, law, density=1e3, formulation=formulation)
    u = 1e-3 * np.random.default_rng(0).normal(size=(model.n_points, 3))
    return model, jnp.asarray(u)


def volumes_at(model):
    """Volume of each quadrature point [m3]."""
    by_tet = np.moveaxis(np.asarray(model.weights), -1, 1)
    return by_tet.reshape(-1, by_tet.shape[-1])[: model.n_tets]


@each_element
def test_stresses_do_the_work_of_the_internal_force(order, formulation):
    model, u = deformed(order, formulation)
    volumes = volumes_at(model)[:, :, None, None]

    @eqx.filter_jit
    def forces(model, u):
        of_stresses = force_of_gradients(model, volumes * tet_stresses(model, u).stress)
        return of_stresses, internal_force(model, u)

    force, exact = map(np.asarray, forces(model, u))
    np.testing.assert_allclose(force, exact, atol=1e-12 * np.max(np.abs(exact)))


def test_the_pressure_slope_is_that_of_the_mean_pressure():
    """By differences of the pressure of an even stretch, where it is all of p."""
    model, _ = deformed(2, "mean-dilatation")
    stresses, x = eqx.filter_jit(tet_stresses), model.mesh.points
    at = lambda stretch: stresses(model, jnp.asarray((stretch - 1.0) * x))

    def pressure(stretch):
        P, J = np.asarray(at(stretch).stress)[0, 0], stretch**3
        return np.trace(P) * stretch / (3.0 * J)

    by_slope = np.einsum("tqii->t", np.asarray(at(1.05).pressure_slope))[0]
    by_difference = (pressure(1.05 + 1e-5) - pressure(1.05 - 1e-5)) / 2e-5
    np.testing.assert_allclose(by_slope, by_difference, rtol=1e-6)


@each_element
def test_the_form_is_symmetric_and_no_fields_lower_it(order, formulation):
    model, _ = deformed(order, formulation)
    patches = stress_patches(model)
    n_qp = model.weights.shape[1]
    size = model.n_tets * n_qp
    squared = lambda s: _rows._squared(patches, s.reshape(model.n_tets, n_qp))
    columns = jax.jit(jax.vmap(squared))(jnp.asarray(np.eye(size)))
    columns = np.asarray(columns).reshape(size, size)
    scale = np.max(np.abs(columns))
    np.testing.assert_allclose(columns, columns.T, atol=1e-12 * scale)
    assert np.linalg.eigvalsh(columns).min() > -1e-12 * scale


def test_faces_under_a_load_are_not_free():
    """Nor those that are held; the traction on the others is an error."""
    model, _ = deformed(1)
    mesh = model.mesh
    load = SurfaceForce("z_max", (0.0, 0.0, -1e-3))
    pose = Configuration("pose", "x_min", (0.0, 0.0, 0.0), load)
    lane = lane_of(configuration_arrays(mesh, [pose]))
    # All others carry nothing in this state, so that those two groups stand out.
    patches = stress_patches(model)

    @jax.jit
    def at_free_faces(u):
        at = tet_stresses(model, u)
        even, lin = jnp.ones_like(at.stress), linearise(model, lane, u)
        return _rows._at_free_faces(lin, patches, even, at.F)

    bearing = np.union1d(mesh.nodes("x_min"), mesh.nodes("z_max"))
    carried = np.isin(np.arange(mesh.n_nodes), bearing)
    with pytest.MonkeyPatch.context() as patch:
        seen = lambda model, u: jnp.asarray(np.where(carried[:, None], 1.0, 0.0))
        patch.setattr(_rows, "internal_force", seen)
        marked = at_free_faces(jnp.zeros((model.n_points, 3)))
    faces = np.asarray(patches.face_nodes)
    free = ~carried[faces].any(axis=1)
    expected = np.unique(np.asarray(patches.face_tet)[free])
    touched = np.flatnonzero(np.any(np.asarray(marked) != 0.0, axis=(1, 2, 3)))
    np.testing.assert_array_equal(touched, expected)
    assert len(expected) > 0
