"""Supports that give way: a bar on springs against its closed form."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from problems import lane_of

from softcal_jax.configurations import (
    Configuration,
    Support,
    SupportReaction,
    SurfaceForce,
    configuration_arrays,
)
from softcal_jax.equilibrium import build_model, compiled_effectors, solve_equilibrium
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import beam

L, A, E = 0.1, 0.02 * 0.02, 1e6
MESH = beam(L, 0.02, 0.02, (3, 1, 1), order=1)
# Without lateral contraction the bar stays in a homogeneous state.
MODEL = build_model(MESH, Corotational(Isotropic(E, 0.0)), density=0.0)


def solved(support, force):
    c = Configuration(
        "pulled",
        support,
        (0.0, 0.0, 0.0),
        SurfaceForce("x_max", (force, 0.0, 0.0)),
        effectors=[SupportReaction("reaction", "x_min", (0.0, 0.0, 0.0))],
    )
    lane = lane_of(configuration_arrays(MESH, [c], MODEL.mechanism))
    solution = solve_equilibrium(MODEL, lane)
    assert bool(solution.converged)
    u = np.asarray(solution.displacement)
    state = solution.displacement, solution.multipliers
    return u, np.asarray(compiled_effectors(MODEL, lane, *state))[0]


def test_a_bar_on_springs_moves_by_both_compliances():
    """u(L) = F / (k A) + F L / (E A): springs and bar in series."""
    k, force = 2e8, 1.0
    u, reaction = solved(Support("x_min", stiffness=k), force)
    at = lambda x: u[np.isclose(MESH.points[:, 0], x), 0]
    np.testing.assert_allclose(at(0.0), force / (k * A), rtol=1e-9)
    np.testing.assert_allclose(at(L), force / (k * A) + force * L / (E * A), rtol=1e-9)
    # The ground holds what is pulled.
    np.testing.assert_allclose(reaction, [-force, 0.0, 0.0], atol=1e-9)


def test_a_stiff_clamp_is_a_rigid_one():
    """The difference falls with the stiffness."""
    rigid, _ = solved(Support("x_min"), 1.0)
    gaps = [
        np.abs(solved(Support("x_min", stiffness=k), 1.0)[0] - rigid).max()
        for k in (1e9, 1e10)
    ]
    np.testing.assert_allclose(gaps[0] / gaps[1], 10.0, rtol=1e-6)


def test_the_springs_follow_an_imposed_displacement():
    moved, _ = solved(Support("x_min", "xyz", (0.0, 0.0, 2e-3), stiffness=1e8), 0.0)
    there = np.tile([0.0, 0.0, 2e-3], (len(moved), 1))
    np.testing.assert_allclose(moved, there, atol=1e-15)


def test_bad_input():
    with pytest.raises(ValueError, match=r"stiffness .*'x_min' .*positive .* -1"):
        Support("x_min", stiffness=-1.0)
    with pytest.raises(ValueError, match=r"stiffness .*surface group"):
        Support(np.array([0, 1]), stiffness=1e6)
    twice = [
        Support("x_min", "x", stiffness=1e6),
        Support("x_min", "yz", stiffness=1.0),
    ]
    with pytest.raises(ValueError, match=r"'x_min' .*two supports"):
        solved(twice, 0.0)


def test_tilted_gravity_keeps_its_size():
    """The angle between both is that of the rotation vector."""
    c = Configuration("tilted", "x_min", (0.3, -9.0, 2.0))
    lane = lane_of(configuration_arrays(MESH, [c]))
    tilt = jnp.array([0.03, -0.04])
    g = np.asarray(c.gravity)
    np.testing.assert_allclose(lane.acceleration, g, rtol=1e-15)
    tilted = np.asarray(eqx.tree_at(lambda c: c.tilt, lane, tilt).acceleration)
    np.testing.assert_allclose(np.linalg.norm(tilted), np.linalg.norm(g))
    cosine = tilted @ g / (g @ g)
    np.testing.assert_allclose(np.arccos(cosine), 0.05, rtol=1e-9)
