"""Errors of the setup as parameters: sensitivities, calibration with the material."""

import pydoc
from dataclasses import fields

import jax.numpy as jnp
import numpy as np
import pytest
from problems import lane_of
from wording import says

from softcal_jax.actuators import Motor
from softcal_jax.bodies import Pose, RigidBody, hinge_axes
from softcal_jax.calibration import calibrate
from softcal_jax.configurations import (
    BodyFrame,
    Configuration,
    ImposedDisplacement,
    configuration_arrays,
)
from softcal_jax.equilibrium import (
    build_model,
)
from softcal_jax.fields import (
    Parameter,
    ParameterSpace,
    Uncertain,
    check_parameters,
    gravity_tilt,
    load_factor,
    motor_zero,
    mounting,
    recording_offset,
)
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import beam
from softcal_jax.robots import simulated_measurements

MOUNTED = (0.0, 0.001, 0.0)
BODIES = [
    RigidBody("base", "x_min", axes=hinge_axes((0, 1, 0)), mounting=Pose(MOUNTED)),
    RigidBody("tip", "x_max", mass=0.01),
]
MODEL = build_model(
    beam(0.1, 0.02, 0.02, (3, 1, 1), order=1),
    Corotational(Isotropic(5e5, 0.3)),
    density=1000.0,
    bodies=BODIES,
    actuators=[Motor("m", "base")],
)
SPACE = ParameterSpace(
    (
        Parameter("E", "E", 5e5, 1e5, 2e6),
        motor_zero("m", limit=0.1, prior_std=None),
        *mounting("base", MOUNTED, limit=2e-3, prior_std=None),
    )
)


def pose(name, angle, effectors=None):
    sensors = effectors or (BodyFrame("sensor", "tip", std=1e-4, std_angle=1e-3),)
    turned = {"m": ImposedDisplacement(angle)}
    return Configuration(name, actuation=turned, effectors=sensors)


@pytest.mark.slow
def test_material_and_setup_are_told_apart():
    """A motor that stands 0.02 rad off, with the modulus unknown as well."""
    z = SPACE.start().at[1].set(0.2)  # a fifth of the limit
    robot = SPACE.model_at(MODEL, z)
    data = simulated_measurements(robot, [pose("a", 0.0), pose("b", 0.8)])
    start = ParameterSpace((Parameter("E", "E", 4e5, 1e5, 2e6), *SPACE.entries[1:]))
    result = calibrate(MODEL, start, data, noise="stated")
    np.testing.assert_allclose(result.value("zero of m"), 0.02, rtol=1e-4)
    np.testing.assert_allclose(result.value("E"), 5e5, rtol=1e-4)
    # Without the zero among the parameters, the modulus takes the blame.
    only = calibrate(MODEL, start.entries[0], data, noise="stated")
    assert abs(only.value("E") / 5e5 - 1.0) > 0.02


def test_bad_input():
    with pytest.raises(ValueError, match=r"motor .*'M'.* mean 'm'"):
        check_parameters(
            MODEL, ParameterSpace((motor_zero("M", limit=0.1, prior_std=None),))
        )
    with pytest.raises(ValueError, match=r"'a' .*twice.*`each`"):
        load_factor(prior_std=None, each=["a", "a"])
    with pytest.raises(ValueError, match=r"recording_offset needs limit, turn_limit"):
        recording_offset(prior_std=1e-3)
    for make in (gravity_tilt, load_factor):
        with pytest.raises(TypeError, match=r"missing .* 'prior_std'"):
            make()
        with pytest.raises(TypeError, match=r"unexpected .*'nominal'"):
            make(prior_std=0.05, nominal=1.0)


def test_help_tells_arguments_units_and_defaults():
    text = pydoc.plain(pydoc.render_doc(load_factor))
    assert "load_factor(of: str = 'loads', *, limit: float = 2.0, prior_std: f" in text
    assert says(" ".join(text.split()), "name of the load", "largest factor ... [-]")
    text = " ".join(pydoc.plain(pydoc.render_doc(mounting)).split())
    assert "`nominal` is the value without an error [m]. `limit` is the larg" in text
    assert says(text, "error per axis", "standard deviation of the prior ... [m]")


def test_help_lists_all_that_is_uncertain():
    text = pydoc.plain(pydoc.render_doc(Uncertain))
    assert all(f"    {field.name}: " in text for field in fields(Uncertain))


def test_an_error_of_one_configuration_leaves_all_others():
    """Also those of another batch, and names that have the same CRC-32."""
    factor = load_factor(prior_std=None, each=["plumless"])
    (unknown,) = factor.parameters
    poses = [pose("plumless", 0.3), pose("buckeroo", 0.3)]
    batches = [configuration_arrays(MODEL.mesh, [p], MODEL.mechanism) for p in poses]
    values = {unknown.name: jnp.asarray(2.0)}
    factors = [
        float(factor.apply(MODEL, lane_of(batch), values)[1].loads.factor[0])
        for batch in batches
    ]
    assert factors == [2.0, 1.0]
