"""A soft finger bent by a cable with friction: states, hysteresis and derivatives.

The cable runs in line along the top of the finger, so that at rest it turns nowhere but
at the clamp, and friction grows as the finger bends.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from bodies import factor_solve
from mechanisms import (
    LENGTH,
    NO_GRAVITY,
    SIDE,
    TIGHT,
    arrays,
    both_ways_at,
    solve,
    solved,
    strip,
)
from problems import assert_second_order

from softcal_jax.actuators import Cable, Guide
from softcal_jax.configurations import (
    ActuatorDisplacement,
    ActuatorForce,
    Centroid,
    Configuration,
    ImposedDisplacement,
    ImposedForce,
)
from softcal_jax.equilibrium import (
    Model,
    build_model,
    continue_equilibrium,
    linearise,
    residual,
)
from softcal_jax.materials import NeoHookean

MESH = strip(6)
TOP = SIDE / 2, SIDE
MU, TENSION = 0.2, 0.8
GUIDES = (
    Guide((-0.02, SIDE / 2, 0.03), "ground"),
    *((LENGTH * k / 6, *TOP) for k in (1, 2, 4, 6)),
)
TIP, SHORTENING, PULL = range(3)
"""Rows of the effectors."""


def finger(**cable) -> Model:
    return build_model(
        MESH,
        NeoHookean(3e5, 0.3),
        density=1000.0,
        actuators=[Cable("cable", GUIDES, **cable)],
    )


PLAIN = finger()
ROUGH = finger(friction=MU, pulled_from="first")
EFFECTORS = (
    Centroid("tip", "at 6"),
    ActuatorDisplacement("shortening", "cable"),
    ActuatorForce("pull", "cable"),
)


def driven(asked) -> Configuration:
    return Configuration(
        "driven", "at 0", NO_GRAVITY, actuation={"cable": asked}, effectors=EFFECTORS
    )


def rubbed(mu) -> Model:
    """The finger with another coefficient of friction."""
    actuators = ROUGH.mechanism.actuators.with_friction(0, mu)
    return eqx.tree_at(lambda m: m.mechanism.actuators, ROUGH, actuators)


out_of_balance = jax.jit(residual)


@pytest.fixture(scope="module")
def pulled():
    """By force: without friction, with it, and let go."""
    plain = solved(PLAIN, driven(ImposedForce(TENSION)), TIGHT)
    rough = solved(ROUGH, driven(ImposedForce(TENSION)), TIGHT)
    back = solved(ROUGH, driven(ImposedForce(TENSION, releasing=True)), TIGHT)
    return plain, rough, back


def test_friction_makes_a_model_without_a_potential():
    assert PLAIN.conservative
    assert not ROUGH.conservative


def test_no_coefficient_is_no_friction(pulled):
    """The unsymmetric system at mu = 0 has the state of the symmetric one."""
    (plain, values, lane), _, _ = pulled
    smooth, smooth_values = solve(rubbed(0.0), lane, None, TIGHT)
    # Both solved to 1e-12 of the forces; the softest mode is 1e3 times softer.
    np.testing.assert_allclose(
        smooth.displacement, plain.displacement, rtol=0, atol=1e-9 * LENGTH
    )
    np.testing.assert_allclose(smooth_values, values, rtol=1e-8, atol=1e-10)


def test_pulling_bends_less_and_letting_go_bends_more(pulled):
    """Hysteresis: one force, three states, and mu has the size of the difference."""
    lift = [values[TIP, 2] for _, values, _ in pulled]
    plain, rough, back = np.array(lift) - SIDE / 2
    assert rough < plain < back
    # Turned by 0.5 in all at most, of which the whole cable feels a part.
    assert 0.01 < (back - rough) / plain < 2 * MU


def test_balance_of_the_whole_finger(pulled):
    """The clamp holds what the cable brings from the ground, with its full tension."""
    for solution, values, lane in pulled[1:]:
        r = np.asarray(out_of_balance(ROUGH, lane, solution.displacement))
        held = MESH.node_groups["at 0"]
        free = np.delete(r[: MESH.n_nodes], held, axis=0)
        np.testing.assert_allclose(free, 0.0, atol=1e-9 * TENSION)
        # Only the segment from the ground crosses from outside.
        weights = ROUGH.mechanism.actuators.groups[0].weights[0]
        at = ROUGH.mechanism.points + solution.displacement
        nodes = ROUGH.mechanism.actuators.groups[0].nodes[0]
        first = np.asarray((weights @ at[nodes])[-2])  # the pulled end is the last
        way = GUIDES[0].point - first
        pull = TENSION * way / np.linalg.norm(way)
        np.testing.assert_allclose(r[held].sum(axis=0), -pull, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(values[PULL, 0], TENSION, rtol=1e-14)


tangent = jax.jit(lambda *state: linearise(*state).system.values)


@jax.jit
def solved_both_ways(model, lane, u, one, two):
    """K^-1 one and K^-T two."""
    x = factor_solve(model, lane, u, one[None]).x[0]
    return x, factor_solve(model, lane, u, two[None], transpose=True).x[0]


@pytest.mark.parametrize("releasing", [False, True])
def test_displacement_imposed_gives_back_the_force(pulled, releasing):
    reference, values, _ = pulled[1 + releasing]
    asked = ImposedDisplacement(values[SHORTENING, 0], releasing=releasing)
    solution, again, lane = solved(ROUGH, driven(asked), TIGHT)
    np.testing.assert_allclose(
        solution.displacement, reference.displacement, rtol=0, atol=1e-9 * LENGTH
    )
    np.testing.assert_allclose(solution.multipliers, [TENSION], rtol=1e-7)
    np.testing.assert_allclose(again, values, rtol=1e-7, atol=1e-10)
    # The adjoint of the bordered system, whose border differs on its two sides.
    u = solution.displacement
    one, two = jr.normal(jr.key(0), (2, *u.shape))
    there, back = solved_both_ways(ROUGH, lane, u, one, two)
    np.testing.assert_allclose(jnp.vdot(there, two), jnp.vdot(back, one), rtol=1e-9)


def test_a_cable_that_is_let_out_goes_slack():
    solution, values, _ = solved(ROUGH, driven(ImposedDisplacement(-0.01)), TIGHT)
    np.testing.assert_allclose(solution.displacement, 0.0, atol=1e-12)
    assert values[PULL, 0] == 0.0


@both_ways_at
def readings(mu, lane):
    return solve(rubbed(mu), lane, None, TIGHT)[1]


@pytest.mark.parametrize("by", ["force", "displacement"])
def test_derivatives_by_the_coefficient_of_friction(pulled, by):
    """Forward = reverse, and differences of second order; tip, shortening and pull."""
    solution, values, lane = pulled[1]
    if by == "displacement":
        lane = arrays(ROUGH, driven(ImposedDisplacement(values[SHORTENING, 0])))
        solution, _ = solve(ROUGH, lane, None, TIGHT)
    mu, one = np.asarray(MU), np.ones(())
    cotangent = np.random.default_rng(1).normal(size=values.shape)
    both = readings(solution, mu, one, cotangent, lane)
    exact, reverse = map(np.asarray, both)
    assert np.abs(exact[TIP]).max() > 1e-3 * LENGTH
    by_force = by == "force"
    assert (exact[SHORTENING, 0] != 0.0) | (not by_force)
    assert (abs(exact[PULL, 0]) > 0.01) | by_force
    alone = lambda mu: np.asarray(solve(rubbed(jnp.asarray(mu)), lane, None, TIGHT)[1])
    assert_second_order(alone, mu, one, exact, (0.1, 0.05), rtol=0.1)
    np.testing.assert_allclose(reverse, np.vdot(cotangent, exact), rtol=1e-8)


def test_the_tangent_is_that_of_the_end_where_a_gap_was_to_close(pulled):
    """The forces at the guides are balanced already."""
    reference, values, _ = pulled[0]
    loose = replace(TIGHT, rtol=1e-2)

    def end(by):
        lane = arrays(PLAIN, driven(ImposedDisplacement(values[SHORTENING, 0] + by)))
        solution, lin = continue_equilibrium(
            PLAIN, lane, reference.displacement, settings=loose, precise=True
        )
        exact = tangent(PLAIN, lane, solution.displacement, solution.multipliers)
        assert int(solution.steps) == 1
        off = np.max(np.abs(np.asarray(lin.system.values) - exact))
        return off / np.max(np.abs(exact))

    assert max(map(end, (0.0, 1e-5))) < 1e-6


def test_releasing_needs_friction():
    asked = driven(ImposedForce(TENSION, releasing=True))
    with pytest.raises(ValueError, match=r"'cable' .*releasing, .*no friction"):
        arrays(PLAIN, asked)
