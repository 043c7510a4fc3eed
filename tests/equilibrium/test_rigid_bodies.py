"""Rigid bodies in equilibrium, on one robot of four of them.

A beam of linear tets, which compile fast; what a body is does not depend on the tets.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from bodies import times
from mechanisms import (
    LENGTH,
    NO_GRAVITY,
    SIDE,
    TIGHT,
    arrays,
    both_ways_at,
    positions,
    solve,
    solved,
    strip,
    values_of,
)
from problems import assert_second_order
from scipy.spatial.transform import Rotation

from softcal_jax.bodies import BodyState, Pose, RigidBody, hinge_axes
from softcal_jax.configurations import BodyFrame, Configuration
from softcal_jax.equilibrium import (
    build_model,
    energy_and_force,
    linearise,
    residual,
    with_points,
)
from softcal_jax.materials import NeoHookean

YOUNG, DENSITY, GRAVITY = 3e5, 1000.0, np.array([1.0, 2.0, -9.0])
MESH = strip(6)
FIN = Pose((1e-3, 2e-3, -1e-3), (0.1, -0.2, 0.15))
TIP = Pose((0.0, 1e-3, 5e-3), (0.2, 0.1, 0.0))
PLATE_CENTRE = np.array([0.05, 0.03, 0.01])
PLATE_MASS, FIN_MASS = 0.02, 0.01
ROOT = RigidBody("root", "at 0")
PLATE = RigidBody(
    "plate",
    "at 2",
    axes=hinge_axes((1.0, 2.0, 0.5)),
    mass=PLATE_MASS,
    centre_of_mass=PLATE_CENTRE,
)
FIN_BODY = RigidBody("fin", "at 3", mounting=FIN, tied_to="plate", mass=FIN_MASS)
END = RigidBody("tip", ("at 5", "at 6"), axes=hinge_axes((0.0, 1.0, 1.0)), mounting=TIP)
LAW = NeoHookean(YOUNG, 0.3)
MODEL = build_model(MESH, LAW, density=DENSITY, bodies=(ROOT, PLATE, FIN_BODY, END))
FLAT = eqx.tree_at(  # the same without mountings
    lambda m: (
        m.mechanism.bodies.mounting_translation,
        m.mechanism.bodies.mounting_rotation,
    ),
    MODEL,
    (jnp.zeros((4, 3)), jnp.zeros((4, 3))),
)
WEIGHTLESS = eqx.tree_at(lambda m: m.mechanism.bodies.mass, FLAT, jnp.zeros(4))
ROOT_NODES, PLATE_NODES = MESH.nodes("at 0"), MESH.nodes("at 2")
FIN_NODES = MESH.nodes("at 3")
TIP_NODES = np.concatenate([MESH.nodes("at 5"), MESH.nodes("at 6")])
NAMES = ("root", "plate", "fin", "tip")
HALF_TURN = np.pi * np.array([0.36, -0.48, 0.8])


def posed(gravity=tuple(GRAVITY), measured=None, **states) -> Configuration:
    """The root is held unless `states` say otherwise; frames of all are followed."""
    frames = [BodyFrame(name, name, measured) for name in NAMES]
    states = {"root": "held"} | states
    return Configuration("posed", gravity=gravity, bodies=states, effectors=frames)


def turn_of(values, name) -> np.ndarray:
    """Rotation of a body from its BodyFrame's rows: points first, turns after."""
    return Rotation.from_rotvec(values[4 + NAMES.index(name)]).as_matrix()


def moved_by(R, origin, translation, X):
    return (X - origin) @ R.T + origin + translation


def same_shape(x, X):
    """Largest change of a distance between nodes [m]."""
    distance = lambda p: np.linalg.norm(p[:, None] - p[None], axis=-1)
    return np.abs(distance(x) - distance(X)).max()


def test_nodes_of_bodies_stay_rigid():
    solution, values, _ = solved(MODEL, posed(), TIGHT)
    x, X = positions(MODEL, solution), MODEL.mechanism.points
    n = MESH.n_nodes
    for k, nodes in enumerate((ROOT_NODES, PLATE_NODES, FIN_NODES, TIP_NODES)):
        points = np.concatenate([nodes, n + 4 * k + np.arange(4)])
        # Exact but for the rounding of positions of size 0.1 m.
        assert same_shape(x[points], X[points]) < 1e-16
        R = turn_of(values, NAMES[k])
        origin = X[n + 4 * k]
        there = moved_by(R, origin, values[k] - origin, X[points])
        np.testing.assert_allclose(x[points], there, rtol=0, atol=1e-16)
    # All but the root have moved by much more.
    assert np.abs(np.asarray(solution.displacement)[TIP_NODES]).max() > 1e-3


def test_mounting_of_a_tied_body_is_its_relative_pose():
    """Exact, however far the body that it is tied to has moved and turned."""
    solution, values, _ = solved(MODEL, posed(), TIGHT)
    x, X = positions(MODEL, solution), MESH.points
    R = turn_of(values, "plate")
    origin = X[PLATE_NODES].mean(axis=0)
    mounted = moved_by(
        FIN.matrix, X[FIN_NODES].mean(axis=0), FIN.translation, X[FIN_NODES]
    )
    there = moved_by(R, origin, values[1] - origin, mounted)
    np.testing.assert_allclose(x[FIN_NODES], there, rtol=0, atol=1e-16)
    assert np.linalg.norm(values[4 + 1]) > 0.05


def test_held_body_is_where_it_is_held():
    """Mounting first, then the pose, both about the origin of the frame."""
    pose = Pose((-0.01, 0.01, 0.0), (0.0, 0.3, 0.2))
    solution, _, _ = solved(MODEL, posed(tip=pose), TIGHT)
    X = MESH.points[TIP_NODES]
    origin = X.mean(axis=0)
    there = moved_by(
        pose.matrix @ TIP.matrix, origin, pose.translation + TIP.translation, X
    )
    x = positions(MODEL, solution)[TIP_NODES]
    np.testing.assert_allclose(x, there, rtol=0, atol=1e-16)


def test_hinged_body_only_turns_about_its_mounted_axis():
    _, values, _ = solved(MODEL, posed(tip="hinged"), TIGHT)
    X = MESH.points[TIP_NODES]
    origin, axis = X.mean(axis=0), TIP.matrix @ hinge_axes((0.0, 1.0, 1.0))[2]
    np.testing.assert_allclose(values[3], origin + TIP.translation, rtol=0, atol=1e-16)
    turn = Rotation.from_matrix(turn_of(values, "tip") @ TIP.matrix.T).as_rotvec()
    np.testing.assert_allclose(np.cross(turn, axis), 0.0, atol=1e-15)
    assert np.linalg.norm(turn) > 1e-2


@jax.jit
def wrenches(model, lane, u):
    """Out-of-balance force and moment of each body, and on each free node."""
    r = residual(model, lane, u)
    lin = linearise(model, lane, u)
    free = lin.free(r)[: u.size].reshape(u.shape)
    return free, lin.posed.gather(u, r)[u.size :].reshape(-1, 6)


def test_held_body_carries_all_weight_and_its_moment():
    """Force and moment balance of the whole robot, with the moved centres of mass."""
    solution, values, lane = solved(MODEL, posed(), TIGHT)
    free, on_bodies = wrenches(MODEL, lane, solution.displacement)
    x, X = positions(MODEL, solution), MESH.points
    volumes = np.abs(np.linalg.det(X[MESH.tets][:, 1:] - X[MESH.tets][:, :1])) / 6.0
    centres = [
        *x[MESH.tets].mean(axis=1),
        values[1]
        + turn_of(values, "plate") @ (PLATE_CENTRE - X[PLATE_NODES].mean(axis=0)),
        values[2],
    ]
    masses = np.array([*DENSITY * volumes, PLATE_MASS, FIN_MASS])
    weight = masses.sum() * GRAVITY
    size = np.linalg.norm(weight)
    length = MODEL.mechanism.bodies.length
    # Converged to 1e-12 of the forces between tets, which are 1e2 times the weight.
    within = partial(np.testing.assert_allclose, rtol=0)
    within(on_bodies[0, :3], -weight, atol=1e-9 * size)
    arms = np.array(centres) - X[ROOT_NODES].mean(axis=0)
    moment = np.cross(arms, masses[:, None] * GRAVITY).sum(axis=0)
    within(on_bodies[0, 3:] * length, -moment, atol=1e-9 * size * LENGTH)
    within(on_bodies[1:], 0.0, atol=1e-9 * size)
    within(free, 0.0, atol=1e-9 * size)


def test_rigid_body_is_the_limit_of_stiff_tets():
    """The difference falls with the first power of the stiffness of the tets."""
    configuration = posed()
    rigid = positions(FLAT, solved(FLAT, configuration, TIGHT)[0])[: MESH.n_nodes]
    stiff = MESH.points[MESH.tets][:, :, 0].mean(axis=1) > 5 / 6 * LENGTH
    bodies = (ROOT, PLATE, eqx.tree_at(lambda b: b.mounting, FIN_BODY, Pose()))
    reference = build_model(MESH, LAW, density=DENSITY, bodies=bodies)
    configuration = eqx.tree_at(lambda c: c.effectors, configuration, ())
    error = []
    for ratio in (1e3, 1e4):
        E = jnp.where(stiff, ratio * YOUNG, YOUNG)
        soft = reference.with_law(eqx.tree_at(lambda law: law.E, LAW, E))
        x = positions(soft, solved(soft, configuration)[0])[: MESH.n_nodes]
        error.append(np.abs(x - rigid).max())
    assert error[0] < 1e-2 * np.abs(rigid - MESH.points).max()
    np.testing.assert_allclose(error[0] / error[1], 10.0, rtol=0.02)


class Terms(NamedTuple):
    """Along a step d of the unknowns: energy, its slope, and d^T K d."""

    energy: jax.Array
    slope: jax.Array
    curvature: jax.Array


@jax.jit
def along(model, lane, u, d, t):
    """Pi, its slope and its curvature at a share t of the step d."""
    robot = linearise(model, lane, u).posed
    d = jnp.where(robot.fixed, 0.0, d)
    v = robot.move(u, t * d)
    pi = energy_and_force(model, v)[0] - jnp.sum(lane.dead_loads * v)
    slope = jnp.vdot(robot.gather(v, residual(model, lane, v)), d)
    values = linearise(model, lane, v).system.values
    curvature = jnp.vdot(d, times(model.solver.sparsity, values, d))
    return Terms(pi, slope, curvature)


@jax.jit
def moved_from_rest(model, lane, d):
    rest = jnp.zeros((model.n_points, 3))
    return linearise(model, lane, rest).posed.move(rest, d)


@pytest.mark.parametrize("root", ["free", "hinged", "held"])
@pytest.mark.parametrize("tip", ["free", "hinged", "held"])
def test_reduced_forces_and_tangent_are_the_derivatives_of_the_potential(root, tip):
    """Far from equilibrium, with forces on nodes of bodies, which turn under them."""
    states = {"root": BodyState(root), "tip": BodyState(tip), "plate": "free"}
    keys = jr.split(jr.key(0), 4)
    lane = arrays(MODEL, posed(gravity=NO_GRAVITY, plate="held"))  # to pass the check
    kinds = arrays(MODEL, posed(root="held", tip=states["tip"])).bodies.kind
    kinds = kinds.at[0].set(("free", "hinged", "held").index(root))
    force = 0.5 * jr.normal(keys[0], lane.loads.force.shape)
    lane = eqx.tree_at(lambda c: (c.loads.force, c.bodies.kind), lane, (force, kinds))
    u = moved_from_rest(MODEL, lane, 1e-3 * jr.normal(keys[1], (MODEL.n_dof,)))
    for key in keys[2:]:
        d = 1e-3 * jr.normal(key, (MODEL.n_dof,))
        exact = along(MODEL, lane, u, d, 0.0)
        error = []
        for h in (0.3, 0.1):
            ahead, behind = (along(MODEL, lane, u, d, s * h) for s in (1.0, -1.0))
            slope = (ahead.energy - behind.energy) / (2 * h)
            curvature = (ahead.slope - behind.slope) / (2 * h)
            error.append((slope - exact.slope, curvature - exact.curvature))
        coarse, fine = np.array(error)
        # A third of the step leaves a ninth, up to terms of fourth order.
        np.testing.assert_allclose(coarse / fine, 9.0, rtol=0.05)


@pytest.mark.parametrize("offset", [-10.0, 0.0, 10.0])
def test_robot_turned_by_about_half_a_turn_is_free_of_stress(offset):
    """And frames near the measured one, half a turn from rest, see no jump there."""
    angle = np.pi + np.deg2rad(offset)
    axis = HALF_TURN / np.pi
    half_turn = Pose(rotation_vector=HALF_TURN)
    guess = None
    for share in (1 / 3, 2 / 3, 1.0):
        pose = Pose((0.1, 0.2, 0.3), share * angle * axis)
        configuration = posed(gravity=NO_GRAVITY, measured=half_turn, root=pose)
        solution, values, _ = solved(WEIGHTLESS, configuration, TIGHT, guess)
        guess = solution.displacement
    X = MODEL.mechanism.points
    origin = X[ROOT_NODES].mean(axis=0)
    there = moved_by(pose.matrix, origin, pose.translation, X)
    np.testing.assert_allclose(
        positions(WEIGHTLESS, solution), there, rtol=0, atol=1e-12
    )
    assert float(solution.min_det_F) > 1.0 - 1e-10
    turns = values[4:]
    expected = np.broadcast_to(np.deg2rad(offset) * axis, (4, 3))
    np.testing.assert_allclose(turns, expected, rtol=0, atol=1e-11)


def on_an_arc(angle):
    """Pose of the tip's frame on an arc with a tangent turned by an angle about -y."""
    s = 5.5 / 6 * LENGTH
    radius, up = s / angle, SIDE / 2
    end = np.array(
        [radius * np.sin(angle), SIDE / 2, up + radius * (1 - np.cos(angle))]
    )
    return Pose(end - [s, SIDE / 2, up], (0.0, -angle, 0.0))


def test_beam_bent_by_about_half_a_turn():
    """Its energy grows with the square of the angle, through half a turn."""
    energies = []
    angles = np.deg2rad([170.0, 190.0])
    for angle in angles:
        configuration = posed(gravity=NO_GRAVITY, tip=on_an_arc(angle))
        solution, values, _ = solved(WEIGHTLESS, configuration, TIGHT)
        energies.append(float(energy_and_force(MODEL, solution.displacement)[0]))
        turn = Rotation.from_rotvec([0.0, -angle, 0.0]).as_matrix()
        np.testing.assert_allclose(turn_of(values, "tip"), turn, rtol=0, atol=1e-14)
    ratio = energies[1] / energies[0] * (angles[0] / angles[1]) ** 2
    # Pure bending, up to the second power of thickness over radius, (h / 2 R)^2.
    strain = SIDE / 2 * angles[1] / LENGTH
    assert abs(ratio - 1.0) < strain**2


class Inputs(NamedTuple):
    """What is varied."""

    translation: jax.Array
    rotation: jax.Array
    mass: jax.Array
    pose_translation: jax.Array
    pose_rotation: jax.Array
    force: jax.Array
    points: jax.Array


def _inputs(both):
    model, lane = both
    bodies = model.mechanism.bodies
    return Inputs(
        bodies.mounting_translation,
        bodies.mounting_rotation,
        bodies.mass,
        lane.bodies.translation,
        lane.bodies.rotation,
        lane.loads.force,
        model.mesh.points,
    )


def frames(inputs, both):
    model, lane = both
    on_points = with_points(model, inputs.points)
    return values_of(on_points, lane, None, _inputs, inputs)


forward_and_reverse = both_ways_at(frames)


@pytest.fixture(scope="module", params=["free", "hinged", "held"])
def start(request):
    states = {
        "free": "free",
        "hinged": BodyState("hinged", Pose((1e-3, 0.0, -2e-3))),
        "held": Pose((1e-3, 0.0, -2e-3), (0.1, -0.1, 0.2)),
    }
    lane = arrays(MODEL, posed(tip=states[request.param]))
    inputs = jax.tree.map(np.asarray, _inputs((MODEL, lane)))
    return (MODEL, lane), inputs, solve(MODEL, lane, None, TIGHT)[0]


def direction(inputs, name):
    """A random direction in one input of a size that the robot can follow."""
    scale = {"translation": 2e-3, "rotation": 0.1, "mass": 0.02, "force": 0.02}
    scale["points"] = 2e-3
    value = getattr(inputs, name)
    noise = np.random.default_rng(3).normal(size=value.shape)
    noise = scale[name.removeprefix("pose_")] * noise
    return jax.tree.map(np.zeros_like, inputs)._replace(**{name: noise})


@pytest.mark.parametrize("name", Inputs._fields)
def test_derivatives_meet_differences_at_second_order(start, name):
    both, inputs, solution = start
    if name == "pose_translation" and int(both[1].bodies.kind[3]) == 0:
        pytest.skip("linear: the robot is held at the root alone, and moves as one")
    tangent = direction(inputs, name)
    still = np.zeros(both[1].effectors.measured.shape)
    jvp = np.asarray(forward_and_reverse(solution, inputs, tangent, still, both)[0])
    assert np.max(np.abs(jvp)) > 1e-4
    function = lambda inputs: np.asarray(frames(inputs, both))
    assert_second_order(function, inputs, tangent, jvp, (0.1, 0.03))


def test_forward_equals_reverse(start):
    both, inputs, solution = start
    parts = [direction(inputs, name) for name in Inputs._fields]
    tangent = jax.tree.map(lambda *same: sum(same), *parts)
    shape = both[1].effectors.measured.shape
    cotangent = np.random.default_rng(5).normal(size=shape)
    forward, reverse = forward_and_reverse(solution, inputs, tangent, cotangent, both)
    products = [float(np.vdot(a, b)) for a, b in zip(reverse, tangent, strict=True)]
    # Both solve with the same factor; rounding times its condition remains.
    np.testing.assert_allclose(sum(products), np.vdot(cotangent, forward), rtol=1e-9)
    # A forgotten input would show as a zero here.
    assert all(abs(part) > 0 for part in products)
