"""Contact against closed forms, balance and what an obstacle must never do."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from softcal_jax.actuators import ForceActuator
from softcal_jax.bodies import BodyState, Pose, RigidBody
from softcal_jax.calibration import calibrate
from softcal_jax.configurations import (
    BodyFrame,
    Configuration,
    ContactForce,
    ContactMoment,
    ImposedForce,
    Support,
    configuration_arrays,
)
from softcal_jax.contact import Ball, HalfSpace, RoundedBox
from softcal_jax.equilibrium import (
    build_model,
    effector_values,
    residual,
    robot_states,
    solve_equilibrium,
)
from softcal_jax.fields import Parameter, exactly_known
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import beam, face_areas

E, NU, SIDE, SCALE = 1e5, 0.3, 0.02, 1e-4
AREA = SIDE**2
WEIGHTLESS = {"gravity": (0.0, 0.0, 0.0)}
SYMMETRY = [Support("x_min", "x"), Support("y_min", "y")]
DOWN = np.diag([1.0, -1.0, -1.0])
"""Axes of a half-space that lies above its plane."""

FLOOR = RigidBody("floor", shape=HalfSpace())
PRESS = RigidBody("press", shape=HalfSpace(), origin=(0, 0, SIDE), axes=DOWN)


def block(*bodies, density=0.0, cells=(2, 2, 2), scale=SCALE, actuators=()):
    """A cube; obstacles of one shape and name share their programs."""
    return build_model(
        beam(SIDE, SIDE, SIDE, cells, order=2),
        Corotational(Isotropic(E, NU)),
        density=density,
        bodies=bodies,
        actuators=actuators,
        contact_scale=scale,
    )


def solved(model, pose):
    solution = solve_equilibrium(model, pose)
    assert bool(solution.converged), str(solution)
    return solution


def felt(model, pose, solution):
    """What each obstacle feels, by name."""
    (state,) = robot_states(model, [pose], jax.tree.map(lambda a: a[None], solution))
    return {contact.name: contact for contact in state.contacts}


def gap_under(model, pressure):
    """Distance between surfaces that press, from the formula of the cushion [m]."""
    stiffness = float(model.mechanism.contacts.stiffness)
    assert stiffness == pytest.approx(1.5 * E / (1.0 + NU))  # three shear moduli
    d = 2.0 * SCALE * np.sqrt(pressure / stiffness)
    if d > 2.0 * SCALE:
        d = SCALE * (1.0 + pressure / stiffness)
    return 0.5 * SCALE - d


@pytest.mark.parametrize("travel", [0.5e-3, 8e-3])
def test_a_block_between_planes_is_compressed_evenly(travel):
    """Uniaxial: P = E (l - 1) of the corotational law, and the cushion's own gaps."""
    model = block(FLOOR, PRESS)
    pose = Configuration("p", SYMMETRY, bodies={"press": Pose((0, 0, -travel))})
    pose = replace(pose, **WEIGHTLESS)
    contacts = felt(model, pose, solved(model, pose))

    def unbalanced(shortening):
        pressure = E * shortening / SIDE
        return SIDE - travel - 2.0 * gap_under(model, pressure) - SIDE + shortening

    strain = brentq(unbalanced, 1e-9, 0.9 * SIDE, xtol=1e-16) / SIDE
    force = AREA * E * strain
    np.testing.assert_allclose(
        contacts["press"].force, (0, 0, force), atol=1e-8 * force
    )
    np.testing.assert_allclose(contacts["floor"].force[2], -force, rtol=1e-8)
    # On a plane, all of it is along the normal: so exactly that of the pressure.
    areas, _ = face_areas(model.mesh, model.mechanism.contacts.faces_of("floor"))
    pushed = areas.sum(axis=1) @ contacts["floor"].pressure
    np.testing.assert_allclose(pushed, force, rtol=1e-8)
    assert contacts["press"].area == pytest.approx(AREA)
    # About the origin of the floor, a corner of the block, which has grown wider.
    middle = 0.5 * SIDE * (1.0 + NU * strain) * force
    np.testing.assert_allclose(
        contacts["floor"].moment, (-middle, middle, 0.0), atol=1e-7 * middle
    )


@pytest.mark.slow
def test_a_weight_that_is_pushed_slides_down_until_the_block_carries_it():
    mass, gravity, pushed = 0.2, 9.81, 1.5
    plate = RoundedBox((0.03, 0.03, 0.01), 2e-3)
    weight = RigidBody(
        "weight", shape=plate, origin=(0.01, 0.01, SIDE + 5e-3), mass=mass
    )
    middle = (0.01, 0.01, SIDE + 0.01)
    push = ForceActuator("push", middle, (0.0, 0.0, -1.0), body="weight")
    model = block(FLOOR, weight, actuators=[push])
    pose = Configuration(
        "p",
        SYMMETRY,
        actuation={"push": ImposedForce(pushed)},
        gravity=(0, 0, -gravity),
        bodies={"weight": "sliding"},
        effectors=[ContactForce("force", "weight"), BodyFrame("place", "weight")],
    )
    solution = solved(model, pose)
    lane = configuration_arrays(model.mesh, [pose], model.mechanism)[0]
    place, _, force = effector_values(model, lane, solution.displacement)
    total = mass * gravity + pushed
    np.testing.assert_allclose(force, (0, 0, total), atol=1e-7)
    pressure = total / AREA
    sunk = SIDE * pressure / E - 2.0 * gap_under(model, pressure)
    np.testing.assert_allclose(place[2], SIDE + 5e-3 - sunk, atol=1e-8)


def test_forces_and_moments_are_in_balance():
    probe = RigidBody("probe", shape=Ball(6e-3), origin=(0.012, 0.007, SIDE + 6e-3))
    model = block(FLOOR, probe, density=1000.0)
    at = Pose((1e-3, 0.5e-3, -2e-3))
    pose = Configuration("p", ["z_min"], bodies={"probe": at, "floor": "absent"})
    solution = solved(model, pose)
    lane = configuration_arrays(model.mesh, [pose], model.mechanism)[0]
    contact = felt(model, pose, solution)["probe"]
    held = np.asarray(residual(model, lane, solution.displacement))
    nodes, x = model.mesh.nodes("z_min"), model.positions(solution.displacement)
    x, on_ground = np.asarray(x)[nodes], held[nodes]
    weight = np.array([0.0, 0.0, -9.80665 * model.mass])
    total = on_ground.sum(axis=0) + weight - contact.force
    assert np.linalg.norm(contact.force) > 0.1
    np.testing.assert_allclose(total, 0.0, atol=1e-8 * np.linalg.norm(contact.force))
    # The moment on a ball is that of forces along its normals: none about its centre.
    np.testing.assert_allclose(contact.moment, 0.0, atol=1e-12)


def test_moment_readings_are_about_the_frame_of_the_obstacle():
    """The same push, read by a frame that stands 10 mm beside."""
    shift, values = np.array([0.01, 0.0, 0.0]), []
    for offset in (np.zeros(3), shift):
        origin = np.array([0.0, 0.0, SIDE]) + offset
        press = RigidBody("press", shape=HalfSpace(), origin=origin, axes=DOWN)
        model = block(FLOOR, press)
        pose = Configuration(
            "p",
            SYMMETRY,
            bodies={"press": Pose((0, 0, -1e-3))},
            effectors=[
                ContactForce("force", "press", axis=(0, 0, 2.0)),
                ContactMoment("moment", "press"),
            ],
            **WEIGHTLESS,
        )
        u = solved(model, pose).displacement
        lane = configuration_arrays(model.mesh, [pose], model.mechanism)[0]
        values.append(np.asarray(effector_values(model, lane, u)))
    (force, moment), (_, moved) = values
    assert force[0] > 1.0
    np.testing.assert_allclose(
        moved, moment - np.cross(shift, (0, 0, force[0])), atol=1e-9
    )


def test_the_scale_of_contact_counts_in_the_error_budget():
    """Between planes E = p H / (travel + 2 g(s)), with g in proportion to s."""
    model, travel = block(FLOOR, PRESS), 1e-3
    pressure = 0.06 * E
    pose = Configuration(
        "p",
        SYMMETRY,
        bodies={"press": Pose((0, 0, -travel))},
        effectors=[ContactForce("cell", "press", (0, 0, 1), AREA * pressure, 1e-3)],
        **WEIGHTLESS,
    )
    found = calibrate(
        model,
        Parameter("E", "elasticity.E", E, 0.2 * E, 5.0 * E),
        [pose],
        noise="stated",
        uncertain=replace(exactly_known(), contact=1.0),
        starts=1,
        intervals=None,
    )
    gap = gap_under(model, pressure)
    modulus = pressure * SIDE / (travel + 2.0 * gap)
    assert found.value("E") == pytest.approx(modulus, rel=1e-6)
    by_scale = abs(modulus * 2.0 * gap / (travel + 2.0 * gap))
    assert found.budget.by_cause()["contact"][0] == pytest.approx(by_scale, rel=1e-4)


@pytest.mark.slow
def test_a_beam_on_a_table_lifts_off_where_beam_theory_says():
    """Clamped level at a height h, its own weight bends it down to the table.

    It is free over l = (72 E I h / q)^(1/4), and its clamp carries 2/3 of q l: from
    w'''' = q / (E I) with w = w' = 0 at the clamp, and w = h, w' = w'' = 0 at l.
    """
    length, width, thick, height, density = 0.2, 4e-3, 2e-3, 4e-3, 1000.0
    stiff = 100.0 * E
    mesh = beam(length, width, thick, (60, 1, 1), origin=(0, 0, height), order=2)
    table = RigidBody("table", shape=HalfSpace())
    model = build_model(
        mesh,
        Corotational(Isotropic(stiff, 0.0)),
        density=density,
        bodies=[table],
        contact_scale=2e-5,
    )
    pose = Configuration("lying", ["x_min"])
    contact = felt(model, pose, solved(model, pose))["table"]
    q, inertia = density * 9.80665 * width * thick, width * thick**3 / 12.0
    free = (72.0 * stiff * inertia * height / q) ** 0.25
    assert 0.3 * length < free < 0.8 * length
    carried = q * length + contact.force[2]
    assert carried == pytest.approx(2.0 / 3.0 * q * free, rel=0.02)


@pytest.mark.slow
def test_a_fast_ball_does_not_pass_a_plate():
    """The plate is thin and the step is long; the ball stays on its side of it."""
    plate = beam(0.04, 0.01, 1e-3, (8, 2, 1), origin=(0, 0, -1e-3), order=2)
    ball = RigidBody("ball", shape=Ball(4e-3), origin=(0.03, 5e-3, 8e-3))
    model = build_model(
        plate, Corotational(Isotropic(1e6, NU)), density=0.0, bodies=[ball]
    )
    pose = Configuration("p", ["x_min"], bodies={"ball": Pose((0, 0, -20e-3))})
    solution = solved(model, replace(pose, **WEIGHTLESS))
    tip = model.positions(solution.displacement)[model.mesh.nodes("x_max")]
    assert np.all(np.asarray(tip)[:, 2] < -8e-3)
    assert felt(model, pose, solution)["ball"].force[2] > 0.0


def test_a_body_that_begins_inside_an_obstacle_is_refused():
    low = RigidBody("press", shape=HalfSpace(), origin=(0, 0, 0.015), axes=DOWN)
    pose = Configuration("p", SYMMETRY)
    with pytest.raises(ValueError, match=r"'p'.* 5 mm inside .*'press'.*`start`"):
        solve_equilibrium(model := block(FLOOR, low), pose)
    # From above it is the same obstacle in the same place.
    start = BodyState("held", start=Pose((0, 0, 6e-3)))
    pose = replace(pose, bodies={"press": start}, **WEIGHTLESS)
    contacts = felt(model, pose, solved(model, pose))
    assert contacts["press"].force[2] > 1.0


@pytest.mark.slow
def test_what_sticks_moves_like_what_is_held():
    """A block sheared between sticking planes, and one whose faces are moved."""
    rough = [replace(body, friction=2.0) for body in (FLOOR, PRESS)]
    shift = np.array([1e-3, 0.0, -2e-3])
    errors = []
    for scale in (2e-4, 1e-4):
        model = block(*rough, scale=scale)
        pose = Configuration("p", bodies={"press": Pose(shift)}, **WEIGHTLESS)
        contact = felt(model, pose, solved(model, pose))["press"]
        held = [Support("z_min"), Support("z_max", displacement=tuple(shift))]
        same = block(cells=(2, 2, 2))
        clamped = Configuration("c", held, **WEIGHTLESS)
        u = solved(same, clamped).displacement
        lane = configuration_arrays(same.mesh, [clamped], same.mechanism)[0]
        force = -np.asarray(residual(same, lane, u))[same.mesh.nodes("z_max")].sum(0)
        errors.append(np.abs(contact.force - force) / np.linalg.norm(force))
        assert contact.sliding < 0.1
    assert np.all(errors[1] < 0.06)
    # The error of contact is in proportion to its scale.
    np.testing.assert_allclose(errors[0][[0, 2]] / errors[1][[0, 2]], 2.0, atol=0.4)


def test_an_absent_obstacle_is_not_there():
    absent = dict.fromkeys(("floor", "press"), "absent")
    pose = Configuration("p", ["z_min"], bodies=absent, **WEIGHTLESS)
    model = block(FLOOR, replace(PRESS, origin=(0.0, 0.0, 0.01)))
    u = np.asarray(solved(model, pose).displacement)
    np.testing.assert_array_equal(u[: model.mesh.n_nodes], 0.0)


def test_bad_obstacles_are_refused():
    with pytest.raises(ValueError, match=r"radius of a sphere .*positive.* -1"):
        Ball(-1.0)
    with pytest.raises(ValueError, match=r"rounding of a box .*0.005 m\), got 0.006"):
        RoundedBox((0.01, 0.02, 0.03), 6e-3)
    with pytest.raises(ValueError, match=r"'b' has no nodes.*`where`.*`shape`"):
        RigidBody("b")
    with pytest.raises(ValueError, match=r"friction .*'b' .*needs a shape"):
        RigidBody("b", "x_min", friction=0.3)
    with pytest.raises(ValueError, match=r"contact_scale .*positive.*0"):
        block(FLOOR, scale=0.0)
    model = block(FLOOR, RigidBody("x", "x_min"))
    with pytest.raises(ValueError, match=r"'x' has nodes .*cannot be absent"):
        solve_equilibrium(model, Configuration("p", bodies={"x": "absent"}))
    pose = Configuration("p", SYMMETRY, effectors=[ContactForce("cell", "wall")])
    with pytest.raises(ValueError, match=r"obstacle .*'cell' 'wall'.*'floor'"):
        solve_equilibrium(model, pose)


def test_the_cushion_does_not_change_how_a_free_robot_moves():
    """Far obstacles leave the equilibrium as it is, to the last digit of the solver."""
    pose = Configuration("p", ["x_min"])
    far = replace(FLOOR, origin=(0, 0, -1.0)), replace(PRESS, origin=(0, 0, 1.0))
    with_it, without = (block(*b, density=1e3) for b in (far, ()))
    u = [np.asarray(solved(m, pose).displacement) for m in (with_it, without)]
    n = without.mesh.n_nodes
    np.testing.assert_allclose(u[0][:n], u[1], atol=1e-9)
    assert jnp.linalg.norm(u[1]) > 0.0
