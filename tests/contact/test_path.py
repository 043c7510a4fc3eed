"""Configurations that come after others, which friction remembers."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from softcal_jax.bodies import BodyState, Pose, RigidBody
from softcal_jax.calibration import (
    Evaluator,
    build_problem,
    calibrate,
    errors,
    evaluate,
    simulation_result,
)
from softcal_jax.configurations import Configuration, ContactForce
from softcal_jax.contact import HalfSpace
from softcal_jax.equilibrium import (
    NewtonSettings,
    Workers,
    build_model,
    equilibria,
    lanes,
    robot_states,
    solve_equilibrium,
)
from softcal_jax.fields import Parameter, ParameterSpace, exactly_known, friction
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.robots import synthetic_measurements

E, MU, SIDE, HIGH, DEPTH = 1e5, 0.3, 0.02, 0.004, 1e-4
NAME = "friction of plate"


def pad(mu: float = MU):
    """A flat pad below a plate; its tangent plane is turned to look down."""
    plate = RigidBody(
        "plate",
        shape=HalfSpace(),
        origin=(0.0, 0.0, HIGH),
        axes=np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1]], float),
        friction=mu,
    )
    mesh = beam(SIDE, SIDE, HIGH, (3, 3, 1), order=2)
    parts = {"density": 0.0, "bodies": [plate], "contact_scale": 5e-5}
    return build_model(mesh, NeoHookean(E, 0.3), **parts)


PAD = pad()


def pose(name: str, aside: float, after: str | None = None, down: float = DEPTH):
    """The plate pressed down, and moved aside."""
    return Configuration(
        name,
        ["z_min"],
        gravity=(0.0, 0.0, 0.0),
        bodies={"plate": BodyState("held", Pose((aside, 0.0, -down)))},
        effectors=[ContactForce("cell", "plate", std=1e-3)],
        after=after,
    )


def forces(model, *poses):
    """Force on the plate in each pose [N]."""
    batch = lanes(model, poses)
    with Workers(model, len(poses)) as workers:
        solution = equilibria(workers, model, batch, NewtonSettings())
    assert np.all(solution.converged), str(solution)
    states = robot_states(model, poses, solution, batch)
    return np.stack([state.contacts[0].force for state in states if state])


def test_a_plate_that_is_pushed_and_drawn_back_goes_around_a_loop():
    """It slides at mu N, then the pad shears back by G A / h, until it slides back."""
    far, little = 2e-3, 2e-5
    pressed, pushed, less, back, again = forces(
        PAD,
        pose("pressed", 0.0),
        pose("pushed", far, "pressed"),
        pose("less", far - little, "pushed"),
        pose("back", 0.0, "less"),
        pose("again", 0.0, "back"),
    )
    assert abs(pressed[0]) < 0.01 * pressed[2]
    limit = MU * pushed[2]
    np.testing.assert_allclose([pushed[0], back[0]], [-limit, limit], rtol=0.02)
    shear = E / 2.6 * SIDE**2 / HIGH
    assert (less[0] - pushed[0]) / little == pytest.approx(shear, rel=0.35)
    np.testing.assert_allclose(again, back, rtol=1e-6)


SPACE = ParameterSpace(
    [
        Parameter("E", "E", 0.8 * E, 0.2 * E, 5.0 * E),
        friction("plate", 0.25, limit=0.2, prior_std=None),
    ]
)
PATH = [pose("pressed", 0.0), pose("pushed", 1e-3, "pressed")]
PATH += [pose("less", 1e-3 - 3e-5, "pushed")]


def problem_of(model, poses):
    truth = {"E": E, NAME: MU}
    read = synthetic_measurements(model, SPACE, poses, truth)
    newton = NewtonSettings(rtol=1e-11)
    return build_problem(model, SPACE, read, newton, uncertain=exactly_known())


def test_derivatives_of_what_comes_after_another():
    """By differences of readings, for what calibrate takes as their compliance."""
    problem = problem_of(pad(), PATH)
    z = problem.space.start()
    now = evaluate(problem, z)
    W = np.asarray(now.response.W_ep)
    u, h = now.equilibrium.displacement, 1e-5
    e = lambda z: np.asarray(evaluate(problem, z, u).effectors).reshape(len(PATH), -1)
    for k, d in enumerate(np.eye(2)):
        slope = (e(z + h * d) - e(z - h * d)) / (2.0 * h)
        np.testing.assert_allclose(W[:, :, k], slope, atol=1e-5 * np.abs(slope).max())
    assert np.all(np.abs(W[1:, 0, 1]) > 0.01)  # of friction on what was pushed


@pytest.mark.slow  # a minute of compiling; as of any pose otherwise
def test_errors_in_reverse_go_through_all_equilibria():
    problem = problem_of(pad(), PATH)
    z = problem.space.start()
    now = evaluate(problem, z)
    u, whole = now.equilibrium.displacement, np.asarray(now.rows.W)
    of_errors = jax.jacrev(lambda z: errors(problem, z, u))(z)
    np.testing.assert_allclose(whole, of_errors, atol=1e-7 * np.abs(whole).max())
    np.testing.assert_allclose(now.rows.error, errors(problem, z, u), rtol=1e-7)


def test_friction_is_calibrated_from_a_way_whose_beginning_is_not_measured():
    truth = {"E": E, NAME: MU}
    read = synthetic_measurements(PAD, SPACE, PATH, truth)
    options = {"noise": "stated", "starts": 1, "intervals": None}
    poses = [PATH[0], *read[1:]]
    found = calibrate(PAD, SPACE, poses, uncertain=exactly_known(), **options)
    assert found.converged
    for name, value in truth.items():
        assert found.value(name) == pytest.approx(value, rel=1e-5)


@pytest.mark.parametrize(
    ("after", "match"),
    [("presed", "'presed'"), ("less", "comes after itself"), ("pushed", "itself")],
)
def test_a_pose_comes_after_another_one_that_is_known(after, match):
    poses = [pose("pressed", 0.0), pose("pushed", 1e-3, after)]
    with pytest.raises(ValueError, match=match):
        lanes(PAD, [*poses, pose("less", 0.0, "pushed")])


def test_a_pose_alone_says_what_it_comes_after():
    with pytest.raises(ValueError, match="following"):
        solve_equilibrium(PAD, lanes(PAD, PATH)[1])
    with pytest.raises(ValueError, match="'pressed'"):
        solve_equilibrium(PAD, PATH[1])


def test_a_fitted_pose_does_not_come_after_one_that_is_held_out():
    first, second, _ = synthetic_measurements(PAD, SPACE, PATH, {"E": E, NAME: MU})
    with pytest.raises(ValueError, match="'pressed', which is held out"):
        calibrate(PAD, SPACE, second, validation=[first])


def test_a_simulation_and_identify_go_through_the_way():
    """A cell reads the force of the obstacle, and compliances are those of a fit."""
    batch = lanes(PAD, PATH)
    with Workers(PAD, len(PATH)) as workers:
        solution = equilibria(workers, PAD, batch, NewtonSettings())
    result = simulation_result(PAD, PATH, solution)
    for pose in result.configurations:
        assert pose.robot is not None
        (cell,) = pose.others
        np.testing.assert_allclose(cell.simulated, pose.robot.contacts[0].force)
    problem = problem_of(PAD, PATH)
    z = problem.space.start()
    now = evaluate(problem, z)
    with Workers(PAD, len(PATH)) as workers:
        evaluator = Evaluator(problem, workers)
        of_all = evaluator.energy_compliances(z, now.equilibrium.displacement)
    W = np.asarray(now.response.W_ep)
    np.testing.assert_allclose(of_all.W_ep, W, atol=1e-6 * np.abs(W).max())


def test_a_lane_without_the_one_it_follows_has_no_equilibrium():
    first, second, third = lanes(PAD, PATH)
    solve = jax.jit(jax.vmap(lambda lane: solve_equilibrium(PAD, lane).converged))
    both = jax.tree.map(lambda *leaves: np.stack(leaves), first, second)
    np.testing.assert_array_equal(solve(both), [True, False])
    still = np.zeros((PAD.n_points, 3))
    with pytest.raises(ValueError, match="another one first"):
        third.following(second, still)
    with pytest.raises(ValueError, match="is another one"):
        third.following(first, still)


def test_an_obstacle_does_not_come_in_where_another_pose_ended():
    absent = replace(PATH[0], bodies={"plate": "absent"})
    with pytest.raises(ValueError, match="'plate' is absent"):
        lanes(PAD, [absent, PATH[1]])
