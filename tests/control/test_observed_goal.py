"""A reading of one's own as a goal."""

import jax.numpy as jnp
import numpy as np
import pytest
from arm import EFFECTORS, arm, pose
from problems import lane_of

from softcal_jax import Observation, solve_inverse
from softcal_jax.actuators import Cable
from softcal_jax.configurations import (
    Centroid,
    Configuration,
    ImposedForce,
    configuration_arrays,
)
from softcal_jax.control import ControlSettings
from softcal_jax.equilibrium import build_model, solve_equilibrium
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam

LENGTH, SIDE = 0.1, 0.02
CABLE = Cable("top", [(0.0, SIDE / 2, SIDE), (LENGTH, SIDE / 2, SIDE)])
MODEL = build_model(
    beam(LENGTH, SIDE, SIDE, (3, 1, 1), order=1),
    NeoHookean(1e5, 0.3),
    density=1000.0,
    actuators=[CABLE],
)
END = np.asarray(MODEL.mesh.node_groups["x_max"])
TENSION = 0.7


def end(model, configuration, state):
    return jnp.mean(model.positions(state.displacement)[END], axis=0)


@pytest.mark.slow
def test_an_observation_is_brought_to_its_goal():
    """Made by simulation with another tension, which comes back."""
    effectors = [Observation("end", end, "m", std=np.full(3, 1e-3))]
    start, bent = (
        Configuration(
            "pulled",
            "x_min",
            effectors=effectors,
            actuation={"top": ImposedForce(tension)},
        )
        for tension in (0.1, TENSION)
    )
    lane = lane_of(configuration_arrays(MODEL.mesh, [bent], MODEL.mechanism))
    goal = np.asarray(end(MODEL, lane, solve_equilibrium(MODEL, lane)))
    assert LENGTH / 50 < abs(goal[2] - SIDE / 2)
    result = solve_inverse(
        MODEL,
        start,
        goals={"end": goal},
        settings=ControlSettings(tol=1e-6, other_starts=0),
    )
    assert result.met
    np.testing.assert_allclose(result.inputs, [TENSION], rtol=1e-5)
    (reached,) = result.goals
    np.testing.assert_allclose(reached.simulated, goal, rtol=0, atol=1e-8)


def tip(model, configuration, state):
    nodes = np.asarray(arm().mesh.node_groups["x_max"])
    return jnp.mean(model.positions(state.displacement)[nodes], axis=0)


@pytest.mark.slow
def test_it_is_brought_where_the_same_effector_is():
    goal = (0.098, 0.01, 0.016)
    usual, observed = (
        solve_inverse(
            arm(),
            pose(effectors=effectors, top=0.1, bottom=0.1, motor=0.0),
            goals={"tip": goal},
            throw=False,
        )
        for effectors in (
            # With the others of the arm, it is the program of other tests.
            [Centroid("tip", "x_max", std=1e-3), *EFFECTORS[1:]],
            [Observation("tip", tip, "m", std=np.full(3, 1e-3))],
        )
    )
    assert observed.outcome == usual.outcome
    inputs, expected = (
        {name: a.value for name, a in result.configuration.actuation.items()}
        for result in (observed, usual)
    )
    assert inputs.keys() == expected.keys()
    for name, value in expected.items():
        assert inputs[name] == pytest.approx(value, rel=1e-5, abs=1e-7)
    assert max(map(abs, expected.values())) > 0.01
    u = observed.solution.displacement
    np.testing.assert_allclose(u, usual.solution.displacement, atol=1e-8)
