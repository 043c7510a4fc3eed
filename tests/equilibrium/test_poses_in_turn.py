"""Poses of a robot with rigid bodies are solved in turn, each from the one before."""

from dataclasses import replace

import numpy as np
import pytest

from softcal_jax.bodies import BodyState, Pose, RigidBody
from softcal_jax.configurations import Configuration, configuration_lanes
from softcal_jax.equilibrium import NewtonSettings, Workers, build_model, equilibria
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam

MESH = beam(0.06, 0.01, 0.01, (6, 1, 1))
TIP = RigidBody("tip", "x_max")
MODEL = build_model(MESH, NeoHookean(2e5, 0.3), density=1000.0, bodies=(TIP,))
BENT = BodyState("held", Pose((0.0, 0.0, 0.02)))
POSE = Configuration("bent", "x_min", gravity=(0.0, 0.0, 0.0), bodies={"tip": BENT})


@pytest.fixture(scope="module")
def solve():
    """Solve a pose twice; returns solutions, and (lane, iterations) as each ends."""
    poses = [POSE, replace(POSE, name="bent again")]
    lanes = configuration_lanes(MESH, poses, MODEL.mechanism).arrays

    def solved(**more):
        ends = []
        note = lambda c, solution: ends.append((c, int(solution.steps)))
        with Workers(MODEL, len(poses)) as workers:
            run = workers, MODEL, lanes, NewtonSettings()
            return equilibria(*run, ended=note, **more), ends

    return solved


def test_a_pose_begins_where_the_one_before_ended(solve):
    solution, ends = solve()
    assert np.all(solution.converged)
    first, second = map(int, solution.steps)
    assert second < first
    assert ends == [(0, first), (1, second)]


def test_the_first_one_begins_at_a_start(solve):
    rest, _ = solve()
    again, _ = solve(start=rest.displacement[0])
    assert int(again.steps[0]) < int(rest.steps[0])
    np.testing.assert_allclose(again.displacement, rest.displacement, atol=1e-9)
