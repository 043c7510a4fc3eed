"""Supports that give way: a bar on springs against its closed form."""

from functools import cache
from math import factorial

import equinox as eqx
import jax
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
from softcal_jax.equilibrium import (
    build_model,
    compiled_effectors,
    linearise,
    residual,
    solve_equilibrium,
)
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import TetMesh, beam, boundary_faces, to_quadratic

L, A, E = 0.1, 0.02 * 0.02, 1e6


@cache
def bar(order, cells=(3, 1, 1)):
    """Without lateral contraction it stays in a homogeneous state."""
    mesh = beam(L, 0.02, 0.02, cells, order=order)
    return build_model(mesh, Corotational(Isotropic(E, 0.0)), density=0.0)


MESH = bar(1).mesh


def lane_on(model, support, force):
    c = Configuration(
        "pulled",
        support,
        (0.0, 0.0, 0.0),
        SurfaceForce("x_max", force),
        effectors=[SupportReaction("reaction", "x_min", (0.0, 0.0, 0.0))],
    )
    return lane_of(configuration_arrays(model.mesh, [c], model.mechanism))


def solved(support, force, model=None):
    model = bar(1) if model is None else model
    lane = lane_on(model, support, force)
    solution = solve_equilibrium(model, lane)
    assert bool(solution.converged)
    u = np.asarray(solution.displacement)
    state = solution.displacement, solution.multipliers
    return u, np.asarray(compiled_effectors(model, lane, *state))[0]


def spring_force(model, lane, u):
    """What the springs add to the forces of the nodes [N]."""
    none = jnp.zeros_like(lane.springs.stiffness)
    bare = eqx.tree_at(lambda c: c.springs.stiffness, lane, none)
    return residual(model, lane, u) - residual(model, bare, u)


@pytest.mark.parametrize("order", [1, 2])
def test_a_bar_on_springs_moves_by_both_compliances(order):
    """u(L) = F / (k A) + F L / (E A): springs and bar in series."""
    k, force = 2e8, 1.0
    model = bar(order)
    soft = Support("x_min", stiffness=k)
    u, reaction = solved(soft, (force, 0.0, 0.0), model)
    at = lambda x: u[np.isclose(model.mesh.points[:, 0], x), 0]
    np.testing.assert_allclose(at(0.0), force / (k * A), rtol=1e-9)
    np.testing.assert_allclose(at(L), force / (k * A) + force * L / (E * A), rtol=1e-9)
    # The ground holds what is pulled.
    np.testing.assert_allclose(reaction, [-force, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("order", "cells"), [(1, (3, 1, 1)), (2, (6, 2, 2)), (2, (12, 3, 3))]
)
def test_a_stiff_clamp_is_a_rigid_one(order, cells):
    """The bent bar's difference falls with the stiffness."""
    model, force = bar(order, cells), (0.0, 0.0, 0.01)
    rigid, _ = solved(Support("x_min"), force, model)
    gaps = [
        np.abs(solved(Support("x_min", stiffness=k), force, model)[0] - rigid).max()
        for k in (1e12, 1e13)
    ]
    np.testing.assert_allclose(gaps[0] / gaps[1], 10.0, rtol=1e-3)
    assert gaps[1] < 1e-5 * np.abs(rigid).max()


def test_the_energy_is_that_of_the_face():
    """k/2 int (u_x^2 + u_z^2) for a quadratic u, on a face whose normal is no axis."""
    points = 0.1 * np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [1.0, 1.0, 1.0]])
    mesh = to_quadratic(TetMesh(points, np.array([[0, 1, 2, 3]])))
    faces = boundary_faces(mesh)
    mesh = mesh.with_surface_group("ground", faces[(faces != 3).all(axis=1)])
    model = build_model(mesh, Corotational(Isotropic(E, 0.0)), density=0.0)
    ground = Support("ground", "xz", stiffness=3e7)
    held = Support(np.array([0, 1, 2, 3]))
    c = Configuration("on ground", [ground, held], (0.0, 0.0, 0.0))
    lane = lane_of(configuration_arrays(mesh, [c], model.mechanism))
    X = mesh.points
    u = 0.1 * np.stack([X[:, 0] ** 2, X[:, 1], X[:, 0] * X[:, 2] - X[:, 1]], axis=1)
    # On the triangle of corners 0.1 e_i: int L1^a L2^b L3^c = 2 A a! b! c! / (2+a+b+c)!
    area = 0.01 * np.sqrt(3.0) / 2.0
    moment = lambda *n: (
        2 * area * np.prod([factorial(k) for k in n]) / factorial(2 + sum(n))
    )
    x4, x2z2, xyz, y2 = (
        moment(*n) for n in ((4, 0, 0), (2, 0, 2), (1, 1, 1), (0, 2, 0))
    )
    square = 1e-4 * x4 + 1e-4 * x2z2 - 2e-3 * xyz + 1e-2 * y2
    expected = 0.5 * 3e7 * 1e-2 * square
    force = spring_force(model, lane, jnp.asarray(u))
    np.testing.assert_allclose(0.5 * np.sum(force * u), expected, rtol=1e-7)


@pytest.mark.parametrize("order", [1, 2])
def test_the_tangent_is_the_derivative_of_the_force(order):
    """And symmetric, so that both have a potential."""
    model = bar(order)
    soft = Support("x_min", "xz", (0.0, 0.0, 1e-3), 1e8)
    lane = lane_on(model, [soft, Support("x_max", "y")], (0.0, 0.0, 0.0))
    u, v, w = 1e-3 * np.random.default_rng(0).normal(size=(3, model.n_points, 3))
    of = linearise(model, lane, jnp.asarray(u)).stiffness
    along = of(jnp.asarray(v))
    force = lambda u: residual(model, lane, u)
    _, expected = jax.jvp(force, (jnp.asarray(u),), (jnp.asarray(v),))
    size = float(jnp.max(jnp.abs(expected)))
    np.testing.assert_allclose(along, expected, rtol=0, atol=1e-12 * size)
    np.testing.assert_allclose(np.vdot(w, along), np.vdot(of(jnp.asarray(w)), v))


@pytest.mark.parametrize("order", [1, 2])
def test_the_derivative_by_the_stiffness(order):
    """Of u(0) = F / (k A), by the implicit rule: -F / (k^2 A)."""
    model, k, force = bar(order), 2e8, 1.0
    lane = lane_on(model, Support("x_min", stiffness=k), (force, 0.0, 0.0))
    node = int(np.flatnonzero(model.mesh.points[:, 0] == 0.0)[0])

    def moved(stiffness):
        soft = eqx.tree_at(lambda c: c.springs.stiffness, lane, stiffness[None])
        return solve_equilibrium(model, soft).displacement[node, 0]

    slope = jax.grad(moved)(jnp.asarray(k))
    np.testing.assert_allclose(slope, -force / (k**2 * A), rtol=1e-6)


@pytest.mark.parametrize("order", [1, 2])
def test_the_springs_follow_an_imposed_displacement(order):
    moving = Support("x_min", "xyz", (0.0, 0.0, 2e-3), stiffness=1e8)
    moved, _ = solved(moving, (0.0, 0.0, 0.0), bar(order))
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
        lane_on(bar(1), twice, (0.0, 0.0, 0.0))


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
