"""Contacts in the state of a robot: of the obstacles that are there."""

import jax
import numpy as np
import pytest
from obstacle_results import beside_obstacles

from softcal_jax.bodies import Pose
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import robot_states, solve_equilibrium

NO_GRAVITY = (0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def contacts():
    """What they are in a pose that the probe presses down, without a table."""
    model = beside_obstacles()
    posed = Configuration(
        "press",
        "x_min",
        gravity=NO_GRAVITY,
        bodies={"probe": Pose((0.0, 0.0, -0.011)), "table": "absent"},
    )
    solved = jax.tree.map(lambda a: a[None], solve_equilibrium(model, posed))
    (state,) = robot_states(model, [posed], solved)
    return state


def test_what_is_absent_feels_nothing(contacts):
    assert [body.state for body in contacts.bodies] == ["held", "absent"]
    assert [contact.name for contact in contacts.contacts] == ["probe"]


def test_the_support_carries_what_the_probe_feels(contacts):
    (probe,), (support,) = contacts.contacts, contacts.reactions
    assert probe.force[2] > 1e-4
    assert probe.area > 0.0
    np.testing.assert_allclose(support.force, probe.force, rtol=1e-5, atol=1e-9)
