"""Fibres much stiffer than a matrix that hardly changes its volume."""

import jax
import jax.numpy as jnp
import numpy as np
from problems import lane_of

from softcal_jax.configurations import Configuration, SurfaceForce, configuration_arrays
from softcal_jax.equilibrium import build_model, solve_equilibrium
from softcal_jax.materials import Fibre, FibreReinforced, NeoHookean
from softcal_jax.mesh import beam

E, E_F = 1e5, 4e6
LENGTH, HEIGHT, FORCE = 0.2, 0.01, 1e-4


def test_a_layer_of_one_cell_bends_as_its_fibres_are_stiff():
    """Timoshenko's cantilever: fibres add to the modulus along it, not to E / 3."""
    mesh = beam(LENGTH, HEIGHT, HEIGHT, (20, 1, 1), order=2)
    law = FibreReinforced(NeoHookean(E, 0.499), E_F, Fibre(0.0))
    model = build_model(mesh, law, density=0.0)
    assert model.formulation == "mean-dilatation"
    end = SurfaceForce("x_max", (0.0, 0.0, FORCE))
    pose = Configuration("end", "x_min", (0.0, 0.0, 0.0), end)
    lane = lane_of(configuration_arrays(mesh, [pose]))
    solution = jax.jit(solve_equilibrium)(model, lane)
    assert solution.converged
    tip = jnp.mean(solution.displacement[mesh.nodes("x_max"), 2])
    bent = FORCE * LENGTH**3 / (3.0 * (E + E_F) * HEIGHT**4 / 12.0)
    sheared = FORCE * LENGTH / (5.0 / 6.0 * E / 3.0 * HEIGHT**2)
    np.testing.assert_allclose(tip, bent + sheared, rtol=0.03)
