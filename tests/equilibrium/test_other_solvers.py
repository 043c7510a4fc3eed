"""Solvers of optimistix in place of Newton's method, at each load."""

import jax
import numpy as np
import optimistix as optx
import pytest
from mechanisms import LENGTH, NO_GRAVITY, SIDE, TIGHT, arrays, strip

from softcal_jax.actuators import Cable, Guide
from softcal_jax.bodies import Pose, RigidBody
from softcal_jax.configurations import Configuration, ImposedDisplacement, Support
from softcal_jax.contact import Ball
from softcal_jax.equilibrium import (
    RESULTS,
    NewtonSettings,
    build_model,
    solve_equilibrium,
)
from softcal_jax.fields import set_field
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam

E = 3e5
LAW = NeoHookean(E, 0.3)
BEAM = build_model(strip(3), LAW, density=1000.0)
LYING = arrays(BEAM, Configuration("lying", "x_min"))
ANY = NewtonSettings(max_steps=5000, max_steps_per_load=1000)
TOLERANCES = {"rtol": 1e-10, "atol": 1e-10}


def guide(x, z, on=None):
    return Guide((x, SIDE / 2, z), on) if on else (x, SIDE / 2, z)


# The solver of other platforms does not count, and is refused: see below.
pytestmark = pytest.mark.skipif(
    not BEAM.solver.can_count, reason="needs a solver that counts"
)


@pytest.mark.parametrize("solver", [optx.Newton, optx.Dogleg, optx.LevenbergMarquardt])
def test_another_solver_finds_the_same_equilibrium(solver):
    ours = solve_equilibrium(BEAM, LYING, settings=TIGHT)
    theirs = solve_equilibrium(BEAM, LYING, solver=solver(**TOLERANCES), settings=ANY)
    assert bool(theirs.converged)
    assert int(theirs.n_negative) == 0
    bent = np.max(np.abs(ours.displacement))
    np.testing.assert_allclose(
        theirs.displacement, ours.displacement, rtol=0, atol=1e-9 * bent
    )


@pytest.mark.slow
def test_bodies_and_imposed_lengths():
    """A cable that pulls a tip, another that stays slack, and the force of each."""
    cables = (
        Cable("top", (guide(-0.01, 0.04, "ground"), guide(LENGTH, SIDE, "tip"))),
        Cable("low", (guide(-0.01, 0.0, "ground"), guide(LENGTH, 0.0, "tip"))),
    )
    model = build_model(
        strip(3),
        LAW,
        density=1000.0,
        bodies=[RigidBody("tip", "at 3")],
        actuators=cables,
    )
    pulls = {"top": ImposedDisplacement(0.01), "low": ImposedDisplacement(-0.05)}
    lane = arrays(model, Configuration("up", "x_min", actuation=pulls))
    ours = solve_equilibrium(model, lane, settings=TIGHT)
    theirs = solve_equilibrium(model, lane, solver=optx.Newton(**TOLERANCES))
    assert bool(theirs.converged)
    top, low = np.asarray(theirs.multipliers)
    assert top > 0.0 == low
    np.testing.assert_allclose(theirs.multipliers, ours.multipliers, rtol=1e-7)
    np.testing.assert_allclose(
        theirs.displacement, ours.displacement, rtol=0, atol=1e-9 * LENGTH
    )


def test_a_support_that_moves_and_a_guess():
    """The clamp is lifted: from rest, and from near by."""
    lifted = Support("x_min", displacement=(0.0, 0.0, 0.02))
    lane = arrays(BEAM, Configuration("lifted", [lifted]))
    ours = solve_equilibrium(BEAM, lane, settings=TIGHT)
    near = 0.9 * ours.displacement
    for guess in (None, near):
        theirs = solve_equilibrium(
            BEAM, lane, guess=guess, solver=optx.Newton(**TOLERANCES)
        )
        assert bool(theirs.converged)
        np.testing.assert_allclose(
            theirs.displacement, ours.displacement, rtol=0, atol=1e-9 * LENGTH
        )


def test_a_solver_that_takes_too_long_ends_without_an_equilibrium():
    few = NewtonSettings(max_steps_per_load=5)
    found = solve_equilibrium(
        BEAM, LYING, solver=optx.LevenbergMarquardt(**TOLERANCES), settings=few
    )
    assert not bool(found.converged)
    assert int(found.steps) <= 205


def test_without_a_count_of_negative_eigenvalues_it_is_refused():
    """A root finder may end in a saddle, which KLU does not tell from a minimum."""
    model = build_model(strip(1), LAW, density=1000.0, solver="klu")
    lane = arrays(model, Configuration("lying", "x_min"))
    with pytest.raises(ValueError, match="unstable"):
        solve_equilibrium(model, lane, solver=optx.Newton(**TOLERANCES))


@pytest.mark.slow
def test_a_ball_does_not_jump_through_a_plate():
    """Moved to its end at once it has passed: the plate would be in balance at rest."""
    plate = beam(0.04, 0.01, 1e-3, (4, 1, 1), origin=(0, 0, -1e-3))
    ball = RigidBody("ball", shape=Ball(4e-3), origin=(0.03, 5e-3, 8e-3))
    model = build_model(plate, LAW, density=0.0, bodies=[ball], contact_scale=1e-4)
    moved = {"ball": Pose((0, 0, -20e-3))}
    pose = Configuration("through", "x_min", gravity=NO_GRAVITY, bodies=moved)
    few = NewtonSettings(smallest_load_step=0.2)
    found = solve_equilibrium(
        model, arrays(model, pose), solver=optx.Newton(**TOLERANCES), settings=few
    )
    assert not bool(found.converged)
    assert float(found.load_reached) < 1.0


def test_derivatives_do_not_depend_on_the_solver():
    def height(E, solver):
        model = set_field(BEAM, "E", E)
        found = solve_equilibrium(model, LYING, solver=solver, settings=TIGHT)
        return found.displacement[-1, 2]

    slope = jax.value_and_grad(height)
    ours, theirs = slope(E, None), slope(E, optx.Newton(rtol=1e-13, atol=1e-13))
    np.testing.assert_allclose(theirs, ours, rtol=1e-7)


def test_a_load_that_is_too_large_for_a_solver_is_cut():
    """Newton's method of optimistix has no line search, and needs more of them."""
    heavy = arrays(BEAM, Configuration("heavy", "x_min", gravity=(0.0, 0.0, -400.0)))
    found = solve_equilibrium(BEAM, heavy, solver=optx.Newton(**TOLERANCES))
    assert bool(found.converged)
    assert int(found.load_steps) > 1
    ours = solve_equilibrium(BEAM, heavy, settings=TIGHT)
    np.testing.assert_allclose(
        found.displacement, ours.displacement, rtol=0, atol=1e-9 * LENGTH
    )


def test_an_unstable_state_is_none():
    """A straight column is in balance under any weight, and buckles under most."""
    on_end = Configuration("on end", "x_min", gravity=(-3000.0, 0.0, 0.0))
    found = solve_equilibrium(
        BEAM, arrays(BEAM, on_end), solver=optx.Newton(**TOLERANCES)
    )
    assert found.result != RESULTS.converged
    assert np.all(np.isnan(found.displacement))


def test_what_is_no_solver_is_refused():
    for solver in ("klu", optx.Newton, optx.FixedPointIteration(1e-8, 1e-8)):
        with pytest.raises(ValueError, match="optimistix"):
            solve_equilibrium(BEAM, LYING, solver=solver)  # type: ignore[arg-type]


def test_no_gravity_is_rest():
    still = arrays(BEAM, Configuration("still", "x_min", gravity=NO_GRAVITY))
    found = solve_equilibrium(BEAM, still, solver=optx.Newton(**TOLERANCES))
    assert bool(found.converged)
    assert not np.any(found.displacement)
