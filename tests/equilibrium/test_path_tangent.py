"""The tangent of a path along the load, where everything that has a load has one.

A strip on springs whose ground moves, with a node that is moved aside, a plate that is
held far round, gravity, a cable that is wound up and a force.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from mechanisms import LENGTH, SIDE, TIGHT, arrays, strip
from problems import nearest_node

from softcal_jax.actuators import Cable, ForceActuator, Guide
from softcal_jax.bodies import Pose, RigidBody
from softcal_jax.configurations import (
    ActuatorForce,
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    Support,
    SupportReaction,
)
from softcal_jax.equilibrium import build_model
from softcal_jax.equilibrium._path import _begin, _step
from softcal_jax.materials import NeoHookean

MESH = strip(3)
MIDDLE = (LENGTH / 3, SIDE, SIDE)
MODEL = build_model(
    MESH,
    NeoHookean(3e5, 0.3),
    density=1000.0,
    bodies=[RigidBody("plate", "at 3")],
    actuators=[
        Cable("cable", (Guide((-0.01, 0.0, -0.05), "ground"), MIDDLE)),
        ForceActuator("push", (2 * LENGTH / 3, SIDE, 0.0), (0.0, 1.0, 2.0)),
    ],
)
STIFFNESS, MOVED, PUSH = 1e7, (1e-3, 0.0, 2e-3), 0.2
GROUND = Support("x_min", displacement=MOVED, stiffness=STIFFNESS)
POSE = Pose((-0.01, 0.005, 0.02), (0.2, -0.5, 0.1))


@pytest.fixture(scope="module")
def lane():
    # The node that the cable pulls: what is held changes its length, too.
    aside = Support(np.array([nearest_node(MESH, MIDDLE)]), "y", (0.0, 2e-3, 0.0))
    configuration = Configuration(
        "loaded",
        [GROUND, aside],
        (0.0, 1.0, -9.81),
        bodies={"plate": POSE},
        actuation={"cable": ImposedDisplacement(0.004), "push": ImposedForce(PUSH)},
        effectors=[
            ActuatorForce("push", "push"),
            ActuatorForce("cable", "cable"),
            SupportReaction("ground", "x_min"),
        ],
    )
    return arrays(MODEL, configuration)


@pytest.fixture(scope="module")
def states(lane):
    """Three neighbours on the path, for each of two distances between them."""
    no, triples = jnp.asarray(False), {}
    start = _begin(MODEL, lane, TIGHT)
    middle = _step(MODEL, lane, start, jnp.asarray(0.5), no, TIGHT)
    for ds in (0.1, 0.05):
        back, on = (
            _step(MODEL, lane, middle, jnp.asarray(sign * ds), no, TIGHT)
            for sign in (-1.0, 1.0)
        )
        assert all(bool(state.ok) for state in (back, middle, on))
        triples[ds] = (back, middle, on)
    return triples


def slope(states, of):
    """Difference of neighbours over that of their loads, and their mean tangent.

    They differ by the error of the trapezoidal rule, of second order.
    """
    back, _, on = states
    difference = (of(on)[0] - of(back)[0]) / (on.load - back.load)
    return difference - 0.5 * (of(on)[1] + of(back)[1])


@pytest.mark.parametrize(
    "of", [lambda s: (s.u, s.du), lambda s: (s.lambda_a, s.d_lambda)]
)
def test_the_tangent_is_the_slope_of_the_states(states, of):
    coarse, fine = (np.abs(slope(three, of)).max() for three in states.values())
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.1)
    middle = states[0.05][1]
    assert fine < 0.01 * np.abs(of(middle)[1]).max()


def test_a_step_is_as_long_as_asked(states):
    """On the plane through the prediction, w <tau_u, du> + tau_t dt = ds."""
    for ds, (_, middle, on) in states.items():
        ahead = middle.weight * np.sum(middle.du * (on.u - middle.u))
        length = (ahead + on.load - middle.load) / middle.length
        np.testing.assert_allclose(length, ds, rtol=1e-3)


def test_readings_are_of_the_load_of_their_state(states):
    area = GROUND.areas(MESH)
    for state in states[0.1]:
        push, cable, ground = np.asarray(state.readings)
        np.testing.assert_allclose(push[0], state.load * PUSH, rtol=1e-12)
        np.testing.assert_allclose(cable[0], state.lambda_a[0], rtol=1e-12)
        u = np.asarray(state.u)[: MESH.n_nodes]
        held = STIFFNESS * area * (np.asarray(state.load) * np.array(MOVED) - u)
        np.testing.assert_allclose(ground, held.sum(axis=0), rtol=1e-9)
