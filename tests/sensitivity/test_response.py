"""Equilibria and compliances in one go: what the two solves give one after the other.

The reference is the equilibrium to rounding, from rest, and the direct compliance with
a factorization of its own.
"""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import lane_of

from softcal_jax.calibration import build_problem, evaluate
from softcal_jax.configurations import (
    Configuration,
    Markers,
    Support,
    SurfaceForce,
)
from softcal_jax.equilibrium import (
    RESULTS,
    NewtonSettings,
    build_model,
    solve_equilibrium,
)
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.materials import (
    ClassicalCorotational,
    Fibre,
    NeoHookean,
    ReducedTransverseIsotropic,
)
from softcal_jax.mesh import TetMesh, beam
from softcal_jax.sensitivity import equilibrium_response, parameter_compliance
from softcal_jax.unknowns import Problem

TIGHT = NewtonSettings(rtol=1e-11)
MARKERS = Markers(["tip"], [[0.1, 0.01, 0.01]])
N_E = 3
DENSITY = Parameter("rho", "density", 1e3, 1e2, 1e4)
MANY = 12
"""Parts of a body whose moduli and density are more than a direct solve takes."""
LIFTED = Support("x_max", "z", (0.0, 0.0, 0.01))


def hanging(name, *supports, side=0.0):
    return Configuration(
        name,
        (Support("x_min"), *supports),
        (0.0, 0.0, -9.81),
        SurfaceForce("x_max", (0.0, side, 0.0)),
        MARKERS,
        MARKERS.positions,
    )


POSES = (hanging("down"), hanging("side", side=0.03), hanging("lifted", LIFTED))


def parts(mesh, n):
    """Groups of tets along the beam."""
    place = mesh.points[mesh.tets].mean(axis=1)[:, 0]
    split = np.array_split(np.argsort(place, kind="stable"), n)
    groups = {f"part {i}": np.sort(tets) for i, tets in enumerate(split)}
    return TetMesh(
        mesh.points, mesh.tets, mesh.node_groups, mesh.surface_groups, groups
    )


@cache
def plain(solver) -> Problem:
    """With the shapes of calibration/light_beam.py, for its programs."""
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)
    law = NeoHookean(1e5, 0.3)
    space = ParameterSpace((Parameter("E", "E", 1e5, 1e4, 1e6), DENSITY))
    model = build_model(mesh, law, density=1000.0, solver=solver)
    return build_problem(model, space, POSES)


@cache
def case(name) -> Problem:
    if name in ("plain", "KLU"):
        return plain("klu" if name == "KLU" else None)
    order = 2 if name == "mean dilatation" else 1
    n_parts = MANY if "many parameters" in name else 2
    classical = name.startswith("no potential")
    mesh = parts(beam(0.1, 0.02, 0.02, (3, 1, 1), order=order), n_parts)
    E = np.full(mesh.n_tets, 1e5)
    law = NeoHookean(E, 0.49 if order == 2 else 0.3)
    if classical:
        law = ClassicalCorotational(ReducedTransverseIsotropic(E, 4e4, 0.3, Fibre(0.5)))
    field = "E_t" if classical else "E"
    parameters = [
        Parameter(f"{field} of {part}", field, 1e5, 1e4, 1e6, region=part)
        for part in mesh.tet_groups
    ]
    space = ParameterSpace((*parameters, DENSITY))
    model = build_model(
        mesh,
        law,
        density=1000.0,
        formulation="mean-dilatation" if order == 2 else "displacement",
    )
    return build_problem(model, space, POSES)


def respond(case, z, guess):
    """As a calibration does: with the careful solve where a guess is not near."""
    return evaluate(case, z, guess).response


@cache
def reference(name):
    """Equilibria, W_ep and dx/dz at values that are not the start's."""
    c, z = case("plain" if name == "KLU" else name), values(name)  # the same body
    model, lanes = c.space.model_at(c.model, z), []
    for index in range(len(POSES)):
        lane = lane_of(c.configurations, index)
        u = solve_equilibrium(model, lane, settings=TIGHT).displacement
        done = parameter_compliance(c.model, lane, u, c.space, z, method="direct")
        lanes.append((u, done.W_ep, done.displacement))
    return tuple(np.stack(part) for part in zip(*lanes, strict=True))


def values(name):
    space = case(name).space
    away = np.linspace(-0.4, 0.3, len(space.names))
    return jnp.asarray(np.asarray(space.start()) + away)


def rest(name):
    return jnp.zeros(reference(name)[0].shape)


def assert_same(name, response, lanes=slice(None), *, rtol):
    """To the residual: rtol of the forces is a hundred times that of the shape."""
    u, W, dx = (a[lanes] for a in reference(name))
    assert bool(jnp.all(response.ok))
    assert bool(jnp.all(response.equilibrium.converged))
    ours = response.equilibrium.displacement
    np.testing.assert_allclose(ours, u, rtol=0, atol=rtol * np.max(np.abs(u)))
    assert np.max(np.abs(W)) > 1e-3  # a parameter without effect would pass all else
    # The tangent is off by the last Newton step.
    np.testing.assert_allclose(
        response.W_ep, W, rtol=0, atol=100.0 * rtol * np.max(np.abs(W))
    )
    if response.displacement is not None:
        np.testing.assert_allclose(
            response.displacement, dx, rtol=0, atol=100.0 * rtol * np.max(np.abs(dx))
        )


def near(name):
    """Guess: equilibria with moduli that are 2 % off, to first order."""
    u, _, dx = reference(name)
    return jnp.asarray(u + 0.02 * np.sum(dx, axis=1))


@pytest.mark.parametrize(
    "name",
    [
        "plain",
        pytest.param("many parameters", marks=pytest.mark.slow),
        pytest.param("KLU", marks=pytest.mark.slow),
        pytest.param("no potential", marks=pytest.mark.slow),
        pytest.param("no potential, many parameters", marks=pytest.mark.slow),
        pytest.param("mean dilatation", marks=pytest.mark.slow),
    ],
)
def test_both_at_once_are_what_the_two_solves_give(name):
    """From rest, and from a good guess."""
    if name == "KLU":
        pytest.importorskip("klujax", reason="not installed on this platform")
    adjoint = "many parameters" in name
    n_p = len(case(name).space.names)
    at_rest = respond(case(name), values(name), rest(name))
    assert at_rest.W_ep.shape == (3, N_E, n_p)
    assert (at_rest.displacement is None) == adjoint
    assert_same(name, at_rest, rtol=1e-6)
    again = respond(case(name), values(name), near(name))
    assert_same(name, again, rtol=1e-5)
    if case(name).model.solver.counts_negative:
        few = again.equilibrium.steps < at_rest.equilibrium.steps
        assert bool(jnp.all(few))
    assert bool(jnp.all(again.equilibrium.residual <= NewtonSettings().rtol))


def test_compliance_without_a_potential_is_not_that_of_the_symmetric_part():
    """The tangent is 0.1 % off symmetric here; the tolerance above tells it."""
    c = case("no potential")
    assert not c.model.conservative
    counted = respond(c, values("no potential"), near("no potential")).equilibrium
    np.testing.assert_array_equal(counted.n_negative, -1)


def test_adjoint_side_without_a_potential_needs_the_transposed_tangent():
    """With the tangent itself W_ep is 0.2 % off."""
    c, z = case("no potential"), values("no potential")
    x = c.model.mesh.points
    bent = np.stack([-x[:, 0] * x[:, 2], 0.0 * x[:, 0], 3.0 * x[:, 0] ** 2], axis=1)
    at = (c.model, lane_of(c.configurations, 1), jnp.asarray(bent), c.space, z)
    direct, adjoint = (
        np.asarray(parameter_compliance(*at, method=method).W_ep)
        for method in ("direct", "adjoint")
    )
    # Two ways through one factorization: rounding of the solve.
    np.testing.assert_allclose(
        adjoint, direct, rtol=0, atol=1e-9 * np.max(np.abs(direct))
    )


def test_a_pose_alone_gives_bit_for_bit_the_same():
    c, guess = case("plain"), near("plain")
    together = respond(c, values("plain"), guess)
    for index in range(3):
        alone = build_problem(c.model, c.space, POSES[index])
        one = respond(alone, values("plain"), guess[index][None])
        same = jax.tree.map(lambda a, b, i=index: (a[0], b[i]), one, together)
        for ours, theirs in jax.tree.leaves(same, is_leaf=lambda x: type(x) is tuple):
            np.testing.assert_array_equal(ours, theirs)


def test_a_vmap_gives_what_a_calibration_does():
    c, z, guess = case("plain"), values("plain"), near("plain")
    one = lambda lane, u: equilibrium_response(
        c.model, c.space, NewtonSettings(), z, lane, u
    )
    assert_same("plain", jax.jit(jax.vmap(one))(c.configurations, guess), rtol=1e-5)


def test_supports_that_moved_take_their_nodes_along():
    """The third pose's guess is that of the first, whose tip is not held."""
    guess = near("plain")[np.array([0, 1, 0])]
    assert_same("plain", respond(case("plain"), values("plain"), guess), rtol=1e-5)


def test_a_bad_guess_costs_steps_and_nothing_else():
    guess = jnp.asarray(-2.0 * reference("plain")[0])
    response = respond(case("plain"), values("plain"), guess)
    assert_same("plain", response, rtol=1e-5)
    free = [0, 1]
    quick = respond(case("plain"), values("plain"), near("plain")).equilibrium.steps
    assert np.all(np.asarray(response.equilibrium.steps - quick)[free] > 0)


def broken(index, force):
    """The plain case with another force on the tip of one pose."""
    c = case("plain")
    tip = np.argmax(c.model.mesh.points[:, 0])
    push = jnp.array([force, 0.0, 0.0])
    changed = c.configurations.loads.force.at[index, 0, tip].add(push)
    return eqx.tree_at(lambda c: c.configurations.loads.force, c, changed)


@pytest.mark.parametrize("force", [np.nan, -1e6], ids=["not finite", "too large"])
def test_a_pose_without_equilibrium_is_flagged_and_disturbs_no_other(force):
    good = respond(case("plain"), values("plain"), near("plain"))
    response = respond(broken(1, force), values("plain"), near("plain"))
    np.testing.assert_array_equal(response.ok, [True, False, True])
    assert not bool(response.equilibrium.converged[1])
    np.testing.assert_array_equal(response.W_ep[1], 0.0)
    for index in (0, 2):
        np.testing.assert_array_equal(response.W_ep[index], good.W_ep[index])


def test_a_law_without_values_is_flagged():
    z = values("plain").at[0].set(jnp.nan)
    response = respond(case("plain"), z, near("plain"))
    assert not bool(jnp.any(response.ok))
    assert not bool(jnp.any(response.equilibrium.result == RESULTS.converged))
    np.testing.assert_array_equal(response.W_ep, 0.0)
