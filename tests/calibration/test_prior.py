"""What is known of a parameter before any data, and what it does to the result."""

from dataclasses import replace
from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest

from softcal_jax.calibration import (
    CalibrationWarning,
    calibrate as calibrate_with,
    checked_problem,
)
from softcal_jax.configurations import Configuration, Markers
from softcal_jax.equilibrium import NewtonSettings, build_model
from softcal_jax.fields import Parameter, ParameterSpace, exactly_known
from softcal_jax.inference import independent, uncertainty
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.robots import simulated_measurements

calibrate = partial(calibrate_with, intervals=None)

MESH = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)
MODEL = build_model(MESH, NeoHookean(400e3, 0.3), density=1000.0)
POSE = Configuration(
    "hanging", "x_min", markers=Markers(["tip"], [(0.1, 0.01, 0.01)], 1e-4)
)


def modulus(prior_std, start=300e3):
    return Parameter("E", "E", start, 50e3, 2e6, prior_std=prior_std)


@pytest.mark.slow  # three calibrations that compile
def test_a_weak_prior_leaves_the_data_alone_and_a_strong_one_wins():
    data = simulated_measurements(MODEL, [POSE])
    known = {"noise": "stated", "uncertain": exactly_known()}
    moduli = {
        std: calibrate(MODEL, modulus(std), data, **known).value("E")
        for std in (None, 10.0, 1e-5)
    }
    np.testing.assert_allclose(moduli[None], 400e3, rtol=1e-5)
    # The weight of the prior against that of the data is the square of their ratio.
    np.testing.assert_allclose(moduli[10.0], 400e3, rtol=1e-4)
    np.testing.assert_allclose(moduli[1e-5], 300e3, rtol=1e-3)


@pytest.mark.slow  # it compiles a calibration of its own
def test_the_optimum_is_the_weighted_mean_in_a_linear_problem():
    """Of z = ln E, whose data say z_d with weight W and whose prior says z_0."""
    data = simulated_measurements(MODEL, [POSE])
    alone = calibrate(MODEL, modulus(None), data, noise="stated")
    weight = float(np.sum(alone.linear.whitened().W ** 2))
    near = 400e3 * np.exp(-1e-4)  # so near that W does not change on the way
    std = 1.0 / np.sqrt(weight)
    both = calibrate(MODEL, modulus(std, near), data, noise="stated")
    np.testing.assert_allclose(np.log(both.value("E") / near), 0.5e-4, rtol=1e-2)
    # Two sources of equal weight halve the variance.
    np.testing.assert_allclose(both.uncertainty.covariance, 0.5 / weight, rtol=1e-2)


def test_a_parameter_that_only_the_prior_knows_has_its_standard_deviation():
    W = np.array([[2.0, 0.0], [1.0, 0.0]])
    linear = replace(independent(W, ("a", "b")), prior_weights=np.array([0.0, 4.0]))
    spread = uncertainty(linear, "stated")
    np.testing.assert_allclose(spread.covariance, np.diag([0.2, 1 / 16]), rtol=1e-12)
    assert spread.degrees_of_freedom == 1  # the second takes none


@pytest.mark.parametrize("known", ["both", "one", "none"])
def test_a_prior_counts_as_a_datum(known):
    one_coordinate = replace(POSE, markers=replace(POSE.markers, axes="z"))
    data = simulated_measurements(MODEL, [one_coordinate])
    density = Parameter(
        "density",
        "density",
        1e3,
        500.0,
        2e3,
        prior_std=None if known == "none" else 0.1,
    )
    E = modulus(0.1 if known == "both" else None)
    space, settings = ParameterSpace((E, density)), NewtonSettings()
    known_exactly = exactly_known()
    check = lambda: checked_problem(
        MODEL, space, tuple(data), newton=settings, uncertain=known_exactly
    )
    if known == "none":
        with pytest.warns(CalibrationWarning, match="2 parameters .* 1 measured"):
            check()
    else:
        check()  # a warning would be an error


def test_a_periodic_angle_is_near_its_start_across_the_bound():
    theta = Parameter(
        "theta",
        "theta",
        1.5,
        -np.pi / 2,
        np.pi / 2,
        scale="linear",
        S=1.0,
        periodic=True,
        prior_std=0.1,
    )
    space = ParameterSpace((theta,))
    np.testing.assert_allclose(
        space.from_prior(jnp.array([-1.5])), [(np.pi - 3.0) / 0.1], rtol=1e-12
    )


def test_a_prior_must_be_positive():
    with pytest.raises(ValueError, match=r"prior_std.*got 0; leave"):
        modulus(0.0)
