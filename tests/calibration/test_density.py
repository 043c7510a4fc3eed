"""The errors and the density that other optimisers and samplers get.

The references are `calibrate` itself, the compliances of Eq. (9), and the normal
density of the linear model, with its covariance as a matrix.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import assert_second_order, both_ways

from softcal_jax.calibration import (
    build_problem,
    calibrate,
    errors,
    evaluate,
    log_density,
)
from softcal_jax.configurations import Configuration, Markers, PointForce
from softcal_jax.equilibrium import NewtonSettings, build_model
from softcal_jax.fields import Parameter, Uncertain
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.robots import simulated_measurements

MARKERS = Markers(("tip", "mid"), [(0.1, 0.01, 0.02), (0.06, 0.01, 0.02)], std=2e-4)
FORCES = {"up": (0.0, 0.0, 0.06), "aside": (0.0, 0.05, 0.0), "again": (0.0, 0.0, 0.06)}
SPACE = [
    Parameter("E", "E", 2.2e5, 5e4, 1e6, unit="Pa"),
    Parameter("rho", "density", 1e3, 5e2, 2e3, unit="kg/m^3", prior_std=0.05),
]
EXACT = NewtonSettings(rtol=1e-12)
STD = Uncertain(mesh=0.0, recordings=3e-4)
MODEL = build_model(
    beam(0.1, 0.02, 0.02, (4, 1, 1), order=1), NeoHookean(2.5e5, 0.3), density=1070.0
)


def poses():
    """Readings with noise of all kinds: jitter, two recordings, creep, a reference."""
    made = [
        Configuration(
            name,
            "x_min",
            (0.0, 0.0, -9.81),
            [PointForce((0.1, 0.01, 0.01), force)],
            MARKERS,
            recording="monday" if name != "again" else "tuesday",
            relative_std=0.01,
        )
        for name, force in FORCES.items()
    ]
    rng = np.random.default_rng(0)
    read = lambda c: c.measured + rng.normal(scale=2e-4, size=c.measured.shape)
    data = simulated_measurements(MODEL, made, newton=EXACT)
    data = [replace(c, measured=read(c)) for c in data]
    return [data[0], replace(data[1], displacement_from="up"), data[2]]


@pytest.fixture(scope="module")
def data():
    return poses()


@pytest.fixture(scope="module")
def result(data):
    options = {"newton": EXACT, "uncertain": STD, "intervals": None}
    return calibrate(MODEL, SPACE, data, noise="estimated", **options)


@pytest.fixture(scope="module")
def problem(data, result):
    return build_problem(MODEL, SPACE, data, EXACT).with_noise(result.noise)


@pytest.fixture(scope="module")
def density(problem, result):
    return log_density(problem, around=result)


AWAY = jnp.array([0.1, -0.05])
TANGENT = jnp.array([1.0, -0.5])
of_density = both_ways(lambda x, density: density(x))


@pytest.fixture(scope="module")
def of_errors(problem):
    return both_ways(partial(errors, problem))


def test_half_their_squares_are_the_cost(problem, result):
    assert result.converged
    assert result.noise.jitter != 1.0
    error = errors(problem, result.z)
    np.testing.assert_allclose(0.5 * error @ error, result.history[-1].cost, rtol=1e-10)


def test_they_are_those_that_the_fit_weighs(problem, result, of_errors):
    """Its compliances are by another way: one factor, and no autodiff of the solve."""
    z = result.z + AWAY
    error, W = map(np.asarray, evaluate(problem, z).rows)
    value, moved, slope_of_cost = of_errors(z, TANGENT, jnp.asarray(error))
    np.testing.assert_allclose(value, error, rtol=0, atol=1e-8)
    size = np.abs(W).max()
    np.testing.assert_allclose(moved, W @ TANGENT, rtol=0, atol=1e-7 * size)
    np.testing.assert_allclose(slope_of_cost, W.T @ error, rtol=1e-7)
    both = jax.vmap(partial(errors, problem))(jnp.stack([z, result.z]))
    np.testing.assert_allclose(both[0], error, rtol=0, atol=1e-8)


def test_each_specimen_deviates_in_its_own_way(problem, result):
    off = jnp.asarray(np.random.default_rng(1).normal(scale=0.1, size=(3, 2)))
    deviating = replace(problem, deviations=off)
    error = evaluate(deviating, result.z).rows.error
    np.testing.assert_allclose(errors(deviating, result.z), error, rtol=0, atol=1e-8)


def test_their_derivatives_meet_differences_at_second_order(problem, result, of_errors):
    z, of_z = result.z + AWAY, partial(errors, problem)
    cotangent = jnp.asarray(np.random.default_rng(2).normal(size=of_z(z).shape))
    _, moved, pulled = of_errors(z, TANGENT, cotangent)
    np.testing.assert_allclose(
        jnp.vdot(pulled, TANGENT), jnp.vdot(cotangent, moved), rtol=1e-9
    )
    assert_second_order(of_z, z, TANGENT, moved, (3e-2, 1e-2), rtol=0.02)


def test_the_density_at_the_fit_is_normal_with_all_errors(density, result):
    """Mahalanobis' distance by a covariance of noise and considered errors."""
    fit, x = result.linear.of_fit(), jnp.zeros(2)
    B, W_c = fit.correlated.values, fit.considered.values
    assert W_c.shape[1] == 5  # nu, two tilts, loads, clamp
    V = fit.scale**2 * (np.eye(len(fit.r)) + B @ B.T) + W_c @ W_c.T
    squares = fit.r @ np.linalg.solve(V, fit.r) + np.sum(fit.from_prior**2)
    value, moved, gradient = of_density(x, TANGENT, jnp.ones(()), density)
    np.testing.assert_allclose(value, -0.5 * squares, rtol=1e-7)
    slope = fit.W.T @ np.linalg.solve(V, fit.r) + fit.prior_weights * fit.from_prior
    expected = -density.factor.T @ slope
    np.testing.assert_allclose(gradient, expected, rtol=1e-5)
    np.testing.assert_allclose(moved, expected @ TANGENT, rtol=1e-5)


def test_its_coordinates_are_whitened_by_the_covariance_by_all_causes(density, result):
    columns = jax.jacobian(density.z)(jnp.zeros(2))
    np.testing.assert_allclose(columns @ columns.T, result.budget.covariance, rtol=1e-9)
    np.testing.assert_array_equal(density.z(jnp.zeros(2)), result.z)


def test_without_a_result_it_is_that_of_the_noise_as_stated(data, result):
    stated = build_problem(MODEL, SPACE, data, EXACT)
    error = errors(stated, result.z)
    found = log_density(stated)(result.z)
    np.testing.assert_allclose(found, -0.5 * error @ error, rtol=1e-8)


def without_equilibrium(density):
    """One iteration finds none."""
    newton = replace(EXACT, max_steps=1).as_arrays()
    return replace(density, problem=replace(density.problem, newton=newton))


@pytest.mark.parametrize(
    ("change", "x"),
    [(lambda d: d, 1e3), (lambda d: d, np.nan), (without_equilibrium, 0.5)],
    ids=["beyond a bound", "nan", "without an equilibrium"],
)
def test_nothing_is_likely_there_and_the_gradient_is_zero(density, change, x):
    density, x = change(density), jnp.full(2, x)
    value, moved, gradient = of_density(x, TANGENT, jnp.ones(()), density)
    assert value == -jnp.inf
    np.testing.assert_array_equal(gradient, 0.0)
    assert moved == 0.0


def test_without_an_equilibrium_all_errors_are_infinite(problem, result):
    hopeless = replace(problem, newton=replace(EXACT, max_steps=1))
    assert np.all(errors(hopeless, result.z) == np.inf)
    with pytest.raises(RuntimeError, match="no equilibrium found"):
        log_density(hopeless, around=result)


def test_a_result_of_another_calibration_is_refused(problem, result):
    fewer = build_problem(MODEL, SPACE[:1], problem.poses, EXACT)
    with pytest.raises(ValueError, match=r"of E and rho and 18 .*problem of E and"):
        log_density(fewer, around=result)


def test_a_parameter_without_a_standard_error_has_no_coordinate(problem, data):
    space = [Parameter("E", "E", 1.8e5, 5e4, 1.9e5, unit="Pa"), SPACE[1]]
    result = calibrate(MODEL, space, data, newton=EXACT, intervals=None, uncertain=STD)
    with pytest.raises(ValueError, match="E has no standard error"):
        log_density(problem, around=result)
