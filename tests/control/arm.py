"""A small arm that the tests of this folder share: two cables and a motor.

A beam along x between two rigid ends. The motor turns its base about -y, so that a
positive angle lifts the tip; the cables run above and below it, from base to tip.
"""

from functools import cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from problems import lane_of
from wording import says

from softcal_jax.actuators import Cable, Guide, Motor
from softcal_jax.bodies import RigidBody, hinge_axes
from softcal_jax.configurations import (
    ActuatorDisplacement,
    ActuatorForce,
    BodyAngle,
    BodyFrame,
    Centroid,
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    configuration_arrays,
)
from softcal_jax.control import actuator_readings, with_inputs
from softcal_jax.equilibrium import (
    Model,
    NewtonSettings,
    build_model,
    solve_equilibrium,
)
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam

_readings = eqx.filter_jit(actuator_readings)
LENGTH, SIDE = 0.1, 0.02
TIGHT = NewtonSettings(rtol=1e-12)
REST = (0.0, 0.0, 0.0)


def _cable(name: str, z: float) -> Cable:
    guides = [
        Guide((0.0, SIDE / 2, z), "base"),
        Guide((LENGTH / 2, SIDE / 2, z)),
        Guide((LENGTH, SIDE / 2, z), "tip"),
    ]
    return Cable(name, guides)


@cache
def arm(young: float = 2e5) -> Model:
    mesh = beam(LENGTH, SIDE, SIDE, (4, 1, 1), order=1)
    base = RigidBody("base", "x_min", axes=hinge_axes((0.0, -1.0, 0.0)))
    return build_model(
        mesh,
        NeoHookean(young, 0.3),
        density=1000.0,
        bodies=[base, RigidBody("tip", "x_max", mass=0.0)],
        actuators=[_cable("top", SIDE), _cable("bottom", 0.0), Motor("motor", "base")],
    )


def pose(gravity=(0.0, 0.0, -2.0), effectors=None, **actuation) -> Configuration:
    """The arm; numbers of cables are tensions [N], that of the motor an angle [rad]."""
    kinds = {"top": ImposedForce, "bottom": ImposedForce, "motor": ImposedDisplacement}
    asked = {
        name: kinds[name](value) if isinstance(value, int | float) else value
        for name, value in actuation.items()
    }
    effectors = [Centroid("tip", "x_max")] if effectors is None else effectors
    return Configuration("arm", gravity=gravity, effectors=effectors, actuation=asked)


def arrays(configuration: Configuration):
    """The configuration as the solver sees it."""
    mechanism = arm().mechanism
    lanes = configuration_arrays(arm().mesh, [configuration], mechanism)
    return lane_of(lanes)


EFFECTORS = [
    Centroid("tip", "x_max"),
    BodyFrame("frame", "tip"),
    BodyAngle("bend", "tip", "base", (0, -1, 0)),  # upwards is positive
    ActuatorDisplacement("pull", "top"),
    ActuatorForce("tension", "bottom"),
    ActuatorForce("torque", "motor"),
]


def solved(model, configuration, value):
    """Equilibrium for one actuation and what follows, by the programs of the search."""
    lane = with_inputs(configuration, jnp.asarray(value))
    solution = solve_equilibrium(model, lane, settings=TIGHT)
    return solution, _readings(model, lane, solution)


def tips(configuration: Configuration, inputs):
    """Positions of the tip at other inputs, each by a simulation from rest."""
    lane, names = arrays(configuration), arm().mechanism.actuators.names
    commanded = [names.index(name) for name in configuration.actuation]
    value, reached = np.array(lane.actuation.value), []
    for drive in inputs:
        value[commanded] = drive
        solution, state = solved(arm(), lane, jnp.array(value))
        assert solution.converged
        reached.append(state.effectors[0])
    return np.stack(reached)


def check_only(texts, words):
    """One limit alone holds, and its text says this."""
    (text,) = texts
    assert says(text, words)
