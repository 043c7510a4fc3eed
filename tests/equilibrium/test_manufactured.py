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
    """Error of the displacement in L2 on the unit cube, E = 1, nu = 0.3, neo-Hookean."""
    mesh = beam(1.0, 1.0, 1.0, (cells, cells, cells), order=order)
    rule = Quadrature.of(mesh)
    flat = jnp.asarray(rule.points.reshape(-1, 3))
    b = np.asarray(manufactured_body_force(flat)).reshape(rule.points.shape)
    forces = np.zeros_like(mesh.points)
    np.add.at(forces, mesh.tets, np.einsum("tq,qa,tqi->tai", rule.weights, rule.values, b))
    configuration = Configuration(
        "cube",
        (Support(boundary_nodes(mesh)),),
        gravity=(0.0, 0.0, 0.0),
        loads=(NodalForces(np.arange(mesh.n_nodes), forces),),
    )
    model = build_model(mesh, NeoHookean(1.0, 0.3), density=1.0, formulation=formulation)
    solution = lane(solve(model, configuration_arrays(mesh, [configuration])), 0)
    assert bool(solution.result == RESULTS.converged)
    u = np.asarray(solution.displacement)[mesh.tets]
    exact = jax.vmap(manufactured_displacement)(flat).reshape(rule.points.shape)
    gap = np.einsum("qa,tai->tqi", rule.values, u) - exact
    norm = lambda field: np.sqrt(np.sum(rule.weights * np.sum(field**2, axis=2)))
    return norm(gap) / norm(np.asarray(exact))


@pytest.mark.parametrize(
    ("order", "formulation", "cells", "expected"),
    [
        (1, "displacement", (8, 12), 2.0),
        (2, "displacement", (6, 8), 3.0),
        (2, "mean-dilatation", (6, 8), 2.0),
    ],
)
def test_order_in_l2(order, formulation, cells, expected):
    """Coarse meshes are a little below their asymptotic order: 1.95 and 2.91."""
    coarse, fine = (l2_error(n, order, formulation) for n in cells)
    slope = np.log(coarse / fine) / np.log(cells[1] / cells[0])
    print(slope, coarse, fine)
    assert expected - 0.15 < slope < expected + 0.15
