"""Motion of 6-D sensors from a configuration that is simulated as well.

How a sensor is mounted is known to millimetres and some degrees. The rigid motion from
one pose to another, T_c T_r^-1, does not depend on it.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from softcal_jax.bodies import Pose, RigidBody
from softcal_jax.calibration import calibrate
from softcal_jax.configurations import (
    BodyFrame,
    Configuration,
    PointForce,
    configuration_arrays,
)
from softcal_jax.equilibrium import (
    NewtonSettings,
    build_model,
    compiled_effectors,
    solve_equilibrium,
)
from softcal_jax.fields import Parameter, exactly_known, set_field
from softcal_jax.identifiability import identify
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam

MESH = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)
END = np.array([0.1, 0.01, 0.01])
E_TRUE = 400e3
MODEL = build_model(
    MESH,
    NeoHookean(E_TRUE, 0.3),
    density=1000.0,
    bodies=[RigidBody("plate", "x_max", origin=END)],
)
TIGHT = NewtonSettings(rtol=1e-12)
E = Parameter("E", "E", 300e3, 100e3, 1e6, unit="Pa")
STD, STD_ANGLE = 1e-4, 1e-3
FRAME = BodyFrame("sensor", "plate", point=END, std=STD, std_angle=STD_ANGLE)
NAMES = "rest", "up", "side"
PUSH = ((0, 0, 0), (0, 0, 0.15), (0, 0.1, 0))
MOUNTED = np.array([1e-3, -0.5e-3, 1.5e-3, 0.025, -0.05, 0.04])
"""Place of the sensor in the frame of the plate [m], and its rotation vector [rad]."""
FAR = 20.0 * MOUNTED
"""Centimetres away, and turned by more than a right angle."""


def poses(reference="rest"):
    """The robot at rest under gravity, and pushed; nothing is measured."""
    return [
        Configuration(
            name,
            "x_min",
            loads=[PointForce((0.1, 0.0, 0.0), push)],
            effectors=[FRAME],
            displacement_from=None if name == reference else reference,
        )
        for name, push in zip(NAMES, PUSH, strict=True)
    ]


LANES = configuration_arrays(MESH, poses(), MODEL.mechanism)


def simulated(value):
    """Position, and rotation vector from rest, of the plate in each pose."""
    model = set_field(MODEL, "E", value)

    def one(c):
        state = solve_equilibrium(model, c, settings=TIGHT)
        return compiled_effectors(model, c, state.displacement, state.multipliers)

    return np.stack([one(c) for c in LANES])


def of_plate(value):
    rows = np.array(simulated(value))  # SciPy's rotations need it writable
    return rows[:, 0], Rotation.from_rotvec(rows[:, 1])


def readings(noise, mounted):
    """What the sensor says: T M, and noise of each coordinate."""
    position, turn = of_plate(E_TRUE)
    size = np.repeat([STD, STD_ANGLE], 3)
    off = noise * size * np.random.default_rng(3).normal(size=(len(position), 6))
    seen = Rotation.from_rotvec(off[:, 3:]) * turn * Rotation.from_rotvec(mounted[3:])
    return position + turn.apply(mounted[:3]) + off[:, :3], seen


def measured(reference="rest", noise=1.0, mounted=MOUNTED):
    position, turn = readings(noise, mounted)
    return [
        replace(c, effectors=[replace(FRAME, measured=Pose(p - END, R.as_rotvec()))])
        for c, p, R in zip(poses(reference), position, turn, strict=True)
    ]


def fitted(configurations):
    options = {"noise": "stated", "uncertain": exactly_known(), "intervals": None}
    return calibrate(MODEL, E, configurations, newton=TIGHT, **options)


@pytest.fixture(scope="module")
def result():
    return fitted(measured())


@pytest.mark.slow
def test_any_mounting_leaves_the_modulus_exact():
    """Columns R d and R r hold what a mounting adds, however large it is."""
    exact = fitted(measured(noise=0.0, mounted=FAR))
    assert exact.converged
    np.testing.assert_allclose(exact.value("E"), E_TRUE, rtol=1e-6)
    for fit in exact.configurations:
        for e in fit.effectors:
            np.testing.assert_allclose(e.residual, 0.0, rtol=0, atol=1e-8)


@pytest.mark.parametrize(("share", "off"), [(0.0, 3e-3), (1.0, 5e-2)])
def test_it_is_the_fit_with_a_free_mounting(share, off):
    """By a minimiser that knows nothing of this one, for modulus and mounting.

    Errors of orientation are counted along axes that half the unknown turn has tilted,
    here by 0.035, and noise by 0.001.
    """
    mounted = share * MOUNTED
    result = fitted(measured(mounted=mounted))
    position, seen = readings(1.0, mounted)

    def error(x):
        origin, turn = of_plate(float(np.exp(x[0])))
        sensor = turn * Rotation.from_rotvec(x[4:])
        shift = origin + turn.apply(x[1:4]) - position
        return np.ravel([shift / STD, (sensor * seen.inv()).as_rotvec() / STD_ANGLE])

    start = np.concatenate([[np.log(E_TRUE)], mounted])
    best = least_squares(error, start, x_scale="jac", diff_step=1e-5, xtol=1e-12)
    spread = np.sqrt(np.linalg.inv(best.jac.T @ best.jac)[0, 0])
    estimate = result.parameters[0]
    relative = estimate.standard_error / estimate.value
    np.testing.assert_allclose(relative, spread, rtol=off)
    close = {"rtol": 0, "atol": off * spread}
    np.testing.assert_allclose(np.log(estimate.value), best.x[0], **close)
    np.testing.assert_allclose(result.history[-1].cost, best.cost, rtol=off)
    assert result.uncertainty.degrees_of_freedom == 3 * 6 - 6 - 1


def test_poses_themselves_would_miss_it(result):
    estimate = result.parameters[0]
    assert abs(estimate.value - E_TRUE) < 3.0 * estimate.standard_error
    plain = [replace(c, displacement_from=None) for c in measured()]
    off = fitted(plain).parameters[0]
    assert off.at_bound or abs(off.value - E_TRUE) > 20.0 * off.standard_error


def test_the_reference_may_be_any_pose(result):
    other = fitted(measured(reference="up")).parameters[0]
    estimate = result.parameters[0]
    np.testing.assert_allclose(other.value, estimate.value, rtol=1e-6)
    np.testing.assert_allclose(other.standard_error, estimate.standard_error, rtol=1e-6)


@pytest.mark.slow
def test_what_it_would_tell_is_known_before():
    """The columns are then those of the simulated poses, not of the measured ones."""
    there = replace(E, start=E_TRUE)
    (predicted,) = identify(
        MODEL, there, poses(), newton=TIGHT, uncertain=exactly_known()
    ).parameters
    exact = fitted(measured(noise=0.0, mounted=np.zeros(6))).parameters[0]
    np.testing.assert_allclose(
        predicted.standard_error, exact.standard_error, rtol=1e-5
    )


def test_an_unknown_reference_is_named_before_solving():
    wrong = replace(poses()[1], displacement_from="nowhere")
    with pytest.raises(ValueError, match=r"displacement_from of .*'up'"):
        identify(MODEL, E, [poses()[0], wrong])
