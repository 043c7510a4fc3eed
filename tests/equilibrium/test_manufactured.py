"""Order of convergence against a solution that is known everywhere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import lane, solve
from problems import (
    Quadrature,
    boundary_nodes,
    manufactured_body_force,
    manufactured_displacement,
)

from softcal_jax.configurations import (
    Configuration,
    NodalForces,
    Support,
    configuration_arrays,
)
from softcal_jax.equilibrium import RESULTS, build_model
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam


def l2_error(cells, order, formulation):
    """Relative error of the displacement in L2; neo-Hookean, E = 1, nu = 0.3."""
    mesh = beam(1.0, 1.0, 1.0, (cells, cells, cells), order=order)
    rule = Quadrature.of(mesh)
    flat = jnp.asarray(rule.points.reshape(-1, 3))
    b = np.asarray(manufactured_body_force(flat)).reshape(rule.points.shape)
    forces = np.zeros_like(mesh.points)
    np.add.at(
        forces, mesh.tets, np.einsum("tq,qa,tqi->tai", rule.weights, rule.values, b)
    )
    configuration = Configuration(
        "cube",
        (Support(boundary_nodes(mesh)),),
        gravity=(0.0, 0.0, 0.0),
        loads=(NodalForces(np.arange(mesh.n_nodes), forces),),
    )
    model = build_model(
        mesh, NeoHookean(1.0, 0.3), density=1.0, formulation=formulation
    )
    solution = lane(solve(model, configuration_arrays(mesh, [configuration])), 0)
    assert bool(solution.result == RESULTS.converged)
    u = np.asarray(solution.displacement)[mesh.tets]
    exact = jax.vmap(manufactured_displacement)(flat).reshape(rule.points.shape)
    gap = np.einsum("qa,tai->tqi", rule.values, u) - exact
    norm = lambda field: np.sqrt(np.sum(rule.weights * np.sum(field**2, axis=2)))
    return norm(gap) / norm(np.asarray(exact))


@pytest.mark.parametrize(
    ("order", "formulation", "cells", "expected", "margin"),
    [
        (1, "displacement", (6, 9), 2.0, 0.1),
        (2, "displacement", (6, 8), 3.0, 0.2),
        (2, "mean-dilatation", (6, 8), 2.0, 0.25),
    ],
)
def test_order_in_l2(order, formulation, cells, expected, margin):
    """Linear 2, quadratic 3; with one volume ratio per tet 2, a tenfold larger error.

    Measured on this mirrored mesh: 2.75, 2.84, 2.89, 2.92 from 4 to 12 cells
    (quadratic) and 1.63, 1.78, 1.85 from 4 to 10 (mixed), both still rising: hence the
    margins. (Kuhn's cells without mirrors give 1.87 and 3.11.)
    """
    coarse, fine = (l2_error(n, order, formulation) for n in cells)
    slope = np.log(coarse / fine) / np.log(cells[1] / cells[0])
    np.testing.assert_allclose(slope, expected, rtol=0, atol=margin)
