"""The parallel robot, assembled: its rod, its symmetry, and printed ones."""

from functools import cache

import equinox as eqx
import numpy as np
import pytest
from arms import arm_pose
from problems import lane_of

from benchmarks._parallel_robot import parallel_robot, pose
from benchmarks._printed_robot import PrintingErrors, printed_robot, read_poses_of
from softcal_jax.configurations import configuration_arrays
from softcal_jax.control import sample_workspace
from softcal_jax.equilibrium import effector_values, solve_equilibrium


@cache
def robot():
    """Not at the import, which every worker of the tests does."""
    return parallel_robot(size=0.02)


@pytest.fixture(scope="module")
def working_point():
    """Equilibrium without weight, with all motors at 45 degrees."""
    c = pose(robot().geometry, "work", [45.0] * 6, std=1e-3, std_angle=1e-2)
    c = eqx.tree_at(lambda c: c.gravity, c, (0.0, 0.0, 0.0))
    model = robot().model
    arrays = configuration_arrays(model.mesh, [c], model.mechanism)
    one = lane_of(arrays)
    solution = solve_equilibrium(model, one)
    assert bool(solution.converged)
    return one, solution


def test_the_rod_holds_both_centres(working_point):
    """They are a rod's length apart, as the geometry has it, exactly."""
    _, solution = working_point
    mesh = robot().model.mesh
    x = mesh.points + np.asarray(solution.displacement)[: mesh.n_nodes]
    lower, upper = (
        x[mesh.nodes(f"{s}/centre")].mean(axis=0) for s in ("lower", "upper")
    )
    length = 2.0 * robot().geometry.rod_half_length
    np.testing.assert_allclose(np.linalg.norm(upper - lower), length, rtol=1e-12)


def test_the_symmetric_robot_stays_in_the_middle(working_point):
    """A third of a turn about y maps robot and field to themselves.

    So without weight the rod moves only along y and turns only about it.
    """
    one, solution = working_point
    values = eqx.filter_jit(effector_values)
    position, turn = np.asarray(values(robot().model, one, solution.displacement))
    # The residual is 1e-8 of forces of newtons on a stiffness of 100 N/m.
    np.testing.assert_allclose(position[[0, 2]], 0.0, atol=1e-8)
    np.testing.assert_allclose(turn[[0, 2]], 0.0, atol=1e-6)


def test_arms_are_where_the_motors_have_them(working_point):
    _, solution = working_point
    mesh = robot().model.mesh
    u = np.asarray(solution.displacement)[: mesh.n_nodes]
    for arm in robot().geometry.arms():
        nodes = mesh.nodes(arm.end)
        wanted = arm_pose(arm, np.deg2rad(45.0))
        x = wanted.matrix @ (mesh.points[nodes] - arm.origin).T
        x = x.T + arm.origin + wanted.translation
        np.testing.assert_allclose(mesh.points[nodes] + u[nodes], x, atol=1e-12)


def test_the_prior_and_the_parameters():
    assert len(robot().space.names) == 36 + 6 + 18
    assert robot().space.has_prior
    material = parallel_robot(size=0.02, prior=None, setup=None).space
    assert len(material.names) == 36
    assert not material.has_prior
    zeros = parallel_robot(size=0.02, setup={"motor_zero": 0.01})
    assert len(zeros.space.names) == 36 + 6
    with pytest.raises(ValueError, match=r"setup knows .* got \['density'\]"):
        parallel_robot(size=0.02, setup={"density": 100.0})
    assert len(robot().configurations) == len(robot().validation) == 7


@pytest.mark.slow  # two robots, which compile for half a minute
def test_printed_robots_differ_and_are_read_with_noise():
    small = {"size": 0.02}
    one, other = (printed_robot(seed=seed, **small) for seed in (0, 1))
    zero = np.asarray(one.model.mechanism.motor_zero)
    assert np.all(zero != np.asarray(other.model.mechanism.motor_zero))
    assert 0.1 < np.rad2deg(np.std(zero)) < 1.5  # of 0.5 degrees, six draws
    exact = PrintingErrors(position=1e-12, orientation=1e-12)
    quiet = printed_robot(seed=0, errors=exact, **small)
    poses = robot().configurations[:1]
    (read,) = read_poses_of(one, poses, seed=0)
    (clean,) = read_poses_of(quiet, poses, seed=0)
    off = (
        read.effectors[0].measured.translation - clean.effectors[0].measured.translation
    )
    # Three draws of 0.3 mm.
    assert 0.05e-3 < np.linalg.norm(off) < 1.2e-3
    assert read.effectors[0].std == poses[0].effectors[0].std


def test_poses_are_found_from_rest_at_once(working_point):
    """The robot stands where its motors drive it, but has lost stability on the way.

    So there are no load steps that lead to most of its poses.
    """
    configurations = (*robot().configurations, *robot().validation)
    model = robot().model
    arrays = configuration_arrays(model.mesh, configurations, model.mechanism)
    for i, c in enumerate(configurations):
        solution = solve_equilibrium(model, lane_of(arrays, i))
        assert bool(solution.converged), c.name
        assert int(solution.steps) <= 30, c.name


@pytest.mark.slow
def test_poses_of_the_workspace_are_found_from_rest():
    """Each has an equilibrium, also those on whose way the robot buckles twice."""
    angles = 30.0 + 30.0 * np.random.default_rng(2).random((100, 6))
    asked, several = robot().configurations[0], np.deg2rad(angles[60::2])
    workspace = sample_workspace(robot().model, asked, several)
    assert not workspace.failures
    assert np.asarray(workspace.solution.steps).max() <= 60
