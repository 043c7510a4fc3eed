"""Inverse control of a cable with friction."""

import pytest

from softcal_jax.actuators import Cable
from softcal_jax.configurations import ActuatorForce, Configuration, ImposedForce
from softcal_jax.control import follow_trajectory
from softcal_jax.equilibrium import build_model
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam


@pytest.mark.slow
def test_a_cable_that_is_let_go_stays_so():
    """Which way it last moved sets the sign of its friction, in every command."""
    guides = [(0.0, 0.01, 0.02), (0.05, 0.01, 0.0), (0.1, 0.01, 0.02)]
    cable = Cable("cable", guides, friction=0.2, pulled_from="first")
    mesh = beam(0.1, 0.02, 0.02, (2, 1, 1))
    law = NeoHookean(3e5, 0.3)
    robot = build_model(mesh, law, density=0.0, actuators=[cable])
    start = Configuration(
        "let go",
        "x_min",
        effectors=[ActuatorForce("tension", "cable")],
        actuation={"cable": ImposedForce(0.5, releasing=True)},
    )
    goals = [{"tension": 0.4}, {"tension": 0.3}]
    for point, goal in zip(
        follow_trajectory(robot, start, goals).points, goals, strict=True
    ):
        asked = point.configuration.actuation["cable"]
        assert asked.releasing
        # One step: the effector is the command itself.
        assert asked.value == pytest.approx(goal["tension"], abs=1e-3)
