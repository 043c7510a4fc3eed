"""A reading of one's own as a goal: it asks what the same effector asks."""

import jax.numpy as jnp
import numpy as np
import pytest
from arm import EFFECTORS, arm, pose

from softcal_jax import Observation, solve_inverse
from softcal_jax.configurations import Centroid

END = arm().mesh.node_groups["x_max"]


def end(model, configuration, state):
    return jnp.mean(model.positions(state.displacement)[np.asarray(END)], axis=0)


@pytest.mark.slow  # calibration/test_observation.py is not
def test_an_observation_is_brought_to_its_goal():
    goal = (0.098, 0.01, 0.016)
    usual, own = (
        solve_inverse(
            arm(),
            pose(effectors=effectors, top=0.1, bottom=0.1, motor=0.0),
            goals={"tip": goal},
            throw=False,
        )
        for effectors in (
            # With the others of the arm, it is the program of other tests.
            [Centroid("tip", "x_max", std=1e-3), *EFFECTORS[1:]],
            [Observation("tip", end, "m", std=np.full(3, 1e-3))],
        )
    )
    assert own.outcome == usual.outcome
    found, expected = (
        {name: a.value for name, a in result.configuration.actuation.items()}
        for result in (own, usual)
    )
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-5, abs=1e-7)
    assert max(map(abs, expected.values())) > 0.01
    u = own.solution.displacement
    np.testing.assert_allclose(u, usual.solution.displacement, atol=1e-8)
