"""Coulomb friction on obstacles against closed forms and differences."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from wording import says

from benchmarks.contact import belt
from softcal_jax.actuators import Cable
from softcal_jax.bodies import BodyState, Pose, RigidBody, hinge_axes
from softcal_jax.calibration import calibrate
from softcal_jax.configurations import (
    Configuration,
    ContactForce,
    PointForce,
)
from softcal_jax.contact import Ball, HalfSpace
from softcal_jax.equilibrium import (
    RESULTS,
    NewtonSettings,
    build_model,
    effector_values,
    lanes,
    no_equilibrium,
    robot_states,
    solve_equilibrium,
)
from softcal_jax.fields import Parameter, ParameterSpace, exactly_known, friction
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.robots import synthetic_measurements

MU, E, SIDE, SCALE = 0.5, 1e5, 0.02, 1e-4
TABLE = RigidBody("table", shape=HalfSpace(), friction=MU)
BLOCK = build_model(
    beam(SIDE, SIDE, SIDE, (2, 2, 2), order=2),
    NeoHookean(E, 0.45),
    density=1000.0,
    bodies=[TABLE],
    contact_scale=SCALE,
)
WEIGHTLESS = {"gravity": (0.0, 0.0, 0.0)}
STEEPEST = np.degrees(np.arctan(MU))


def felt(model, pose, solution):
    (state,) = robot_states(model, [pose], jax.tree.map(lambda a: a[None], solution))
    return state.contacts[0]


def on_slope(degrees, g=9.81):
    angle = np.radians(degrees)
    return Configuration("p", gravity=(g * np.sin(angle), 0.0, -g * np.cos(angle)))


@pytest.mark.parametrize("degrees", [0.0, 10.0, STEEPEST - 0.1])
def test_a_block_on_a_slope_stays_up_to_the_angle_of_friction(degrees):
    pose = on_slope(degrees)
    solution = solve_equilibrium(BLOCK, pose)
    assert bool(solution.converged), str(solution)
    contact = felt(BLOCK, pose, solution)
    weight = BLOCK.mass * np.asarray(pose.gravity)
    np.testing.assert_allclose(contact.force, weight, atol=1e-7 * BLOCK.mass)
    assert (contact.sliding > 0.9) == (degrees > 26.0)


@pytest.mark.parametrize("degrees", [STEEPEST + 0.1, 60.0])
def test_a_block_on_a_steeper_slope_slides(degrees):
    solution = solve_equilibrium(BLOCK, on_slope(degrees))
    assert RESULTS.slides == solution.result
    assert float(solution.load_reached) == 0.0
    text = no_equilibrium(solution, ("p",))
    assert says(text, '"table" near', "0) mm", "100 % of the touched area slides")


@pytest.mark.parametrize("height", [1e-3, 0.05])
def test_a_block_above_a_rough_table_falls_on_it(height):
    """No share of its weight leaves it where it is; the table then carries all."""
    table = RigidBody("table", shape=HalfSpace(), origin=(0, 0, -height), friction=MU)
    model = build_model(
        BLOCK.mesh, BLOCK.law, density=1000.0, bodies=[table], contact_scale=SCALE
    )
    pose = on_slope(0.0)
    solution = solve_equilibrium(model, pose)
    assert bool(solution.converged), str(solution)
    weight = model.mass * np.asarray(pose.gravity)
    force = felt(model, pose, solution).force
    np.testing.assert_allclose(force, weight, atol=1e-7 * model.mass)
    fallen = -np.asarray(solution.displacement)[: model.mesh.n_nodes, 2].mean()
    assert fallen == pytest.approx(height, abs=2.0 * SCALE)


def test_a_block_that_falls_away_from_a_table_has_no_equilibrium():
    solution = solve_equilibrium(BLOCK, on_slope(180.0))
    assert not bool(solution.converged)
    assert float(solution.load_reached) == 0.0


@pytest.mark.parametrize("friction", [0.0, MU])
def test_a_hinged_beam_comes_down_on_a_table(friction):
    """The table carries half of its weight; it is stiff, and turns by a tenth."""
    mesh = beam(0.1, 0.01, 0.01, (5, 1, 1), order=2)
    hinge = RigidBody("hinge", "x_min", axes=hinge_axes((0, 1, 0)))
    below = {"shape": HalfSpace(), "origin": (0.0, 0.0, -0.01)}
    table = RigidBody("table", friction=friction, **below)
    model = build_model(
        mesh, NeoHookean(1e7, 0.45), density=1000.0, bodies=[hinge, table]
    )
    pose = Configuration("p", bodies={"hinge": BodyState("hinged")})
    solution = solve_equilibrium(model, pose)
    assert bool(solution.converged), str(solution)
    force = felt(model, pose, solution).force[2]
    np.testing.assert_allclose(force, -0.5 * 9.81 * model.mass, rtol=0.03)


@pytest.mark.slow
def test_a_block_does_not_balance_far_away():
    """Where everything slides, the tangent is nearly singular, and steps are long."""
    newton = optimistix.Newton(rtol=1e-9, atol=1e-9)
    pose = on_slope(STEEPEST + 1.0)
    assert not bool(solve_equilibrium(BLOCK, pose, solver=newton).converged)


def test_what_is_clamped_is_not_said_to_slide():
    """A probe slides over it, and Newton's method is stopped meanwhile."""
    friction = lambda model: model.mechanism.contacts.friction
    pad = eqx.tree_at(friction, PAD, jnp.array([0.1]))
    settings = NewtonSettings(max_steps=3)
    solution = solve_equilibrium(pad, dragged(2e-3), settings=settings)
    assert RESULTS.max_steps == solution.result


@pytest.mark.slow
@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_where_a_rough_table_stands_along_itself_does_not_matter(turn):
    """Its mounting is no slip, neither for the state nor for what it leads to."""
    pose = replace(on_slope(10.0), effectors=[ContactForce("force", "table")])
    lane = lanes(BLOCK, pose)[0]

    @jax.jit
    def state(aside):
        of = lambda m: m.mechanism.bodies
        where = lambda m: (of(m).mounting_translation, of(m).mounting_rotation)
        moved = jnp.array([[1.0, 0.0, 0.0]]) * aside, jnp.array([[0.0, 0.0, turn]])
        model = eqx.tree_at(where, BLOCK, moved)
        return solve_equilibrium(model, lane).displacement[:-4]

    nominal = state(0.0)
    assert np.abs(nominal).max() > 1e-6
    np.testing.assert_allclose(state(5e-4), nominal, atol=1e-12)
    assert np.abs(jax.jit(jax.jacfwd(state))(0.0)).max() < 1e-9


@pytest.mark.parametrize("load", [0.15, 5.0])
def test_a_block_that_is_pressed_on_a_rough_table_is_stable(load):
    """It spreads against friction; the table carries all."""
    top = PointForce((0.5 * SIDE, 0.5 * SIDE, SIDE), (0.0, 0.0, -load))
    pose = replace(on_slope(0.0), loads=[top])
    solution = solve_equilibrium(BLOCK, pose)
    assert bool(solution.converged), str(solution)
    total = -load - 9.81 * BLOCK.mass
    np.testing.assert_allclose(
        felt(BLOCK, pose, solution).force, (0.0, 0.0, total), atol=1e-7 * load
    )


@pytest.mark.parametrize("rise", [0.0, 1e-3])
@pytest.mark.parametrize("moved", [1e-6, 1e-5, 1e-3])
def test_shear_grows_with_slip_up_to_mu_times_the_pressure(moved, rise):
    """Under a held face that just touches, p = E / 16.

    Only the share of the way behind where the face enters the cushion is slip.
    """
    below = BodyState("held", Pose((moved, 0.0, 0.0)), Pose((0.0, 0.0, -rise)))
    pose = Configuration("p", ["z_min"], bodies={"table": below}, **WEIGHTLESS)
    contact = felt(BLOCK, pose, solve_equilibrium(BLOCK, pose))
    slip = moved * (0.5 * SCALE / rise if rise else 1.0)
    x = 3.0 * slip / (MU * SCALE)
    shear = MU * (x - 0.25 * x**2 if x < 2.0 else 1.0)
    pressure = SIDE**2 * float(BLOCK.mechanism.contacts.stiffness) / 16.0
    expected = -pressure * np.array([shear, 0.0, 1.0])
    np.testing.assert_allclose(contact.force, expected, rtol=1e-6, atol=1e-9)
    assert contact.sliding == (x >= 2.0)


BALL = RigidBody("ball", shape=Ball(8e-3), origin=(0.01, 0.01, 0.0282), friction=0.3)
PAD = build_model(
    beam(SIDE, SIDE, SIDE, (3, 3, 2), order=2),
    NeoHookean(E, 0.45),
    density=0.0,
    bodies=[BALL],
    contact_scale=5e-4,
)


def dragged(aside, name="p"):
    """Press the ball into the clamped pad, and move it along it."""
    return Configuration(
        name,
        ["z_min"],
        bodies={"ball": Pose((aside, 0.0, -2e-3))},
        effectors=[ContactForce("force", "ball", measured=(0.0, 0.0, 0.0))],
        **WEIGHTLESS,
    )


def force_of(pose):
    """Return its force as a function of a factor on the modulus, and of friction."""
    lane, tight = lanes(PAD, pose)[0], NewtonSettings(rtol=1e-12)

    @jax.jit
    def force(p):
        model = PAD.with_law(NeoHookean(E * p[0], 0.45))
        where = lambda m: m.mechanism.contacts.friction
        model = eqx.tree_at(where, model, p[1:])
        u = solve_equilibrium(model, lane, settings=tight).displacement
        return effector_values(model, lane, u).ravel()

    return force


@pytest.mark.slow
def test_no_friction_is_a_bound_that_a_fit_may_reach():
    """Force and derivative are those without friction, and of a little of it."""
    force, p = force_of(dragged(2e-3)), jnp.array([1.0, 0.0])
    smooth = RigidBody("ball", shape=BALL.shape, origin=BALL.origin)
    plain = build_model(
        PAD.mesh, PAD.law, density=0.0, bodies=[smooth], contact_scale=5e-4
    )
    lane = lanes(plain, dragged(2e-3))[0]
    u = solve_equilibrium(plain, lane, settings=NewtonSettings(rtol=1e-12))
    without = effector_values(plain, lane, u.displacement).ravel()
    np.testing.assert_allclose(force(p), without, rtol=1e-8, atol=1e-9)
    slope = jax.jit(jax.jacfwd(force))(p)[:, 1]
    assert abs(slope[0]) > 0.1
    h = 1e-4
    ahead = 4.0 * force(p.at[1].add(h)) - force(p.at[1].add(2.0 * h)) - 3.0 * force(p)
    np.testing.assert_allclose(slope, ahead / (2.0 * h), atol=1e-4 * abs(slope[0]))


@pytest.mark.parametrize("aside", [2e-5, 2e-3], ids=["sticks", "slides"])
def test_derivatives_of_what_sticks_and_slides(aside):
    """By modulus and friction, forward against reverse, and against differences."""
    force = force_of(dragged(aside))
    p = jnp.array([1.0, 0.3])
    forward, reverse = jax.jit(jax.jacfwd(force))(p), jax.jit(jax.jacrev(force))(p)
    np.testing.assert_allclose(forward, reverse, rtol=1e-8, atol=1e-9)
    assert (abs(forward[0, 1]) > 0.1) == (aside > 1e-3)  # of what slides
    errors = []
    for h in (3e-4, 1e-4):
        steps = [h * d for d in jnp.eye(2)]
        slopes = [(force(p + d) - force(p - d)) / (2.0 * h) for d in steps]
        errors.append(np.abs(np.stack(slopes, axis=1) - forward).max())
    assert errors[1] < 1e-5 * np.abs(forward).max()
    assert errors[1] < 0.2 * errors[0]


@pytest.mark.slow
def test_friction_is_calibrated_beside_the_modulus():
    """From the forces of a probe that is pressed, and of one that is dragged on."""
    poses = [dragged(0.0, "pressed"), dragged(2e-3, "dragged")]
    space = ParameterSpace(
        [
            Parameter("E", "E", 0.8 * E, 0.2 * E, 5.0 * E),
            friction("ball", 0.2, limit=0.19, prior_std=None),
        ]
    )
    truth = {"E": E, "friction of ball": 0.3}
    data = synthetic_measurements(PAD, space, poses, truth)
    options = {"noise": "stated", "starts": 1, "intervals": None}
    found = calibrate(PAD, space, data, uncertain=exactly_known(), **options)
    assert found.converged
    for name, value in truth.items():
        assert found.value(name) == pytest.approx(value, rel=1e-5)


def test_the_name_of_a_cable_and_an_obstacle_is_refused():
    """It would not tell whose friction is meant."""
    guides = [(0.01, 0.01, 0.002), (0.012, 0.01, 0.01), (0.01, 0.01, 0.018)]
    cable = Cable("ball", guides, friction=0.2, pulled_from="first")
    parts = {"density": 0.0, "bodies": [BALL], "actuators": [cable]}
    model = build_model(PAD.mesh, PAD.law, **parts)
    with pytest.raises(ValueError, match="'ball' is the name of two"):
        friction("ball", 0.2, limit=0.1, prior_std=None).check(model)


@pytest.mark.slow
def test_a_belt_over_a_drum_holds_what_euler_and_eytelwein_say():
    """T2 = T1 exp(mu theta), for a belt whose middle runs h / 2 beside the drum."""
    solve, most = belt()
    assert bool(solve(0.99 * most).converged)
    assert not bool(solve(1.01 * most).converged)
