"""Displacements from a configuration that is simulated as well: differences of poses.

Markers are glued millimetres from where they are said to be, and seen to a tenth of a
millimetre. The reference hangs under its weight, so neither side is undeformed.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from problems import assert_second_order
from scipy.optimize import fminbound

from softcal_jax.calibration import build_problem, calibrate, evaluate
from softcal_jax.configurations import (
    Configuration,
    Markers,
    SurfaceForce,
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
from softcal_jax.layouts import compare_laws
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam

MESH = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)
E_TRUE = 400e3
MODEL = build_model(MESH, NeoHookean(E_TRUE, 0.3), density=1000.0)
TIP, MIDDLE, CORNER = (0.1, 0.01, 0.01), (0.05, 0.02, 0.01), (0.1, 0.0, 0.0)
STD = 1e-4
MARKERS = Markers(["tip", "middle", "corner"], [TIP, MIDDLE, CORNER], STD)
"""With a force on the end, poses have the shapes of those of test_correlated_noise."""
TIGHT = NewtonSettings(rtol=1e-12)
E = Parameter("E", "E", 300e3, 100e3, 1e6, unit="Pa")
NAMES = "rest", "up", "side", "down"
PUSH = ((0, 0, 0), (0, 0, 0.15), (0, 0.1, 0), (0, 0, -0.1))


def poses(reference="rest"):
    """The robot at rest under gravity, and pushed; nothing is measured."""
    return [
        Configuration(
            name,
            "x_min",
            loads=[SurfaceForce("x_max", push)],
            markers=MARKERS,
            displacement_from=None if name == reference else reference,
        )
        for name, push in zip(NAMES, PUSH, strict=True)
    ]


LANES = configuration_arrays(MESH, poses())


def positions(value):
    """Positions of the markers at a modulus, one row of nine per pose."""
    model = set_field(MODEL, "E", value)

    def one(c):
        state = solve_equilibrium(model, c, settings=TIGHT)
        return compiled_effectors(model, c, state.displacement, state.multipliers)

    return np.stack([np.asarray(one(c)).ravel() for c in LANES])


@pytest.fixture(scope="module")
def data():
    """Measured positions with glue and noise."""
    random = np.random.default_rng(0)
    glue = 1e-3 * np.array([0.5, -1.0, 2.0, 1.0, 0.5, -1.0, 0.2, 0.3, 2.0])
    return np.asarray(positions(E_TRUE)) + glue + STD * random.normal(size=(4, 9))


def measured(data, reference="rest"):
    return [
        replace(c, measured=row.reshape(3, 3))
        for c, row in zip(poses(reference), data, strict=True)
    ]


def fitted(configurations, **more):
    options = {"noise": "stated", "uncertain": exactly_known(), "intervals": None}
    return calibrate(MODEL, E, configurations, newton=TIGHT, **(options | more))


@pytest.fixture(scope="module")
def result(data):
    configurations = measured(data)
    return fitted(configurations[:3], validation=configurations[3:])


def differences(value):
    """Displacements of the fitted poses from the reference, by hand."""
    x = np.asarray(positions(value))
    return x[1:3] - x[0]


V_INVERSE = np.linalg.inv(STD**2 * (np.eye(2) + np.ones((2, 2))))
"""Of the two displacements of a coordinate, which share the noise of the reference."""


def test_it_is_the_fit_of_differences_made_by_hand(data, result):
    """By their full covariance, with a minimiser that knows nothing of this one."""
    wanted = data[1:3] - data[0]

    def cost(log):
        d = differences(float(np.exp(log))) - wanted
        return 0.5 * np.einsum("ci,cd,di->", d, V_INVERSE, d)

    low, high = np.log([0.8 * E_TRUE, 1.25 * E_TRUE])
    best = np.asarray(fminbound(cost, low, high, xtol=1e-8)).item()
    assert result.converged
    relative = result.parameters[0].standard_error / result.value("E")
    # Offsets of 2 mm within 100 mm: a share of 4e-4 of the weight, and of 1e-4 of a
    # standard error; the minimiser leaves 1e-7.
    close = {"rtol": 0, "atol": 1e-4 * relative}
    np.testing.assert_allclose(np.log(result.value("E")), best, **close)
    np.testing.assert_allclose(result.history[-1].cost, cost(best), rtol=1e-3)
    step = 1e-3
    low, high = (differences(float(np.exp(best + s))) for s in (-step, step))
    W = (high - low) / (2.0 * step)
    expected = 1.0 / np.sqrt(np.einsum("ci,cd,di->", W, V_INVERSE, W))
    np.testing.assert_allclose(relative, expected, rtol=1e-4)


def test_the_truth_is_found_and_positions_would_miss_it(data, result):
    estimate = result.parameters[0]
    assert abs(estimate.value - E_TRUE) < 3.0 * estimate.standard_error
    plain = [replace(c, displacement_from=None) for c in measured(data)[:3]]
    # The glue holds the tip up by nearly as much as its weight pulls it down.
    assert fitted(plain).parameters[0].at_bound


def test_results_compare_displacements(result):
    """Fitted and held out: 0.1 mm of noise is left, not 2 mm of glue."""
    for fit in result.configurations:
        assert fit.rms_after < 4.0 * STD
        assert not fit.misfit("stated", 1.0)
    assert result.history[-1].rms < 3.0 * STD
    assert result.configurations[3].name == "down"
    assert result.uncertainty.degrees_of_freedom == 18 - 1
    assert not result.checks.recordings


def test_the_reference_may_be_any_pose(data):
    """Differences from another one carry the same information."""
    first, other = (fitted(measured(data, name)) for name in ("rest", "up"))
    np.testing.assert_allclose(first.value("E"), other.value("E"), rtol=1e-6)
    np.testing.assert_allclose(
        first.parameters[0].standard_error,
        other.parameters[0].standard_error,
        rtol=1e-6,
    )


def test_what_it_would_tell_is_known_before(result):
    """`identify` predicts the standard error, at the values that were found."""
    there = replace(E, start=result.value("E"))
    outlook = identify(
        MODEL, there, poses()[:3], newton=TIGHT, uncertain=exactly_known()
    )
    (predicted,) = outlook.parameters
    expected = result.parameters[0].standard_error
    np.testing.assert_allclose(predicted.standard_error, expected, rtol=1e-5)


def test_the_noise_is_estimated_from_displacements(data):
    result = fitted(measured(data), noise="estimated")
    # Of 36 coordinates 9 find the offsets, 1 the modulus: 26 are left.
    assert result.uncertainty.degrees_of_freedom == 26
    np.testing.assert_allclose(result.uncertainty.level, 1.0, rtol=0.5)


def test_rows_are_the_differences_of_both_compliances(data):
    """Exactly those of the two poses, and the derivative of their errors."""
    two = measured(data)[:2]
    problem = build_problem(MODEL, E, two, newton=TIGHT, uncertain=exactly_known())
    z = problem.space.start()
    at = evaluate(problem, z)
    W = np.asarray(at.response.W_ep).reshape(2, 9)
    W_white = np.asarray(at.rows.W)[:-1]
    whitened = W_white.reshape(2, 9)
    # (I + A A^T)^-1/2 with A far above one takes out the mean of both,
    # to the share std / GLUED of it.
    close = {"rtol": 0, "atol": 2e-4 * np.abs(W).max() / STD}
    np.testing.assert_allclose(whitened[1], 0.5 * (W[1] - W[0]) / STD, **close)
    np.testing.assert_allclose(whitened[0], -whitened[1], **close)

    error = lambda z: evaluate(problem, z).rows.error[:-1]
    assert_second_order(error, z, jnp.ones(1), np.ravel(W_white), (0.1, 0.05))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"displacement_from": "nowhere"}, "displacement_from of .*'up'"),
        ({"displacement_from": "up"}, "has a reference"),
        ({"displacement_from": "side"}, "has a reference"),
        (
            {"markers": Markers(["tip", "end", "corner"], [TIP, TIP, CORNER], STD)},
            "'end'.*not measured",
        ),
    ],
)
def test_bad_references(data, change, message):
    configurations = measured(data)
    configurations[1] = replace(configurations[1], **change)
    with pytest.raises(ValueError, match=message):
        fitted(configurations)


def test_held_out_poses_are_scored_without_glue(data):
    """Where a marker is glued is known from the poses of the fit alone."""
    laws = {
        "right": (MODEL, E),
        "stiff": (MODEL, Parameter("E", "E", 700e3, 600e3, 1e6)),
    }
    comparison = compare_laws(laws, measured(data)[:3], newton=TIGHT)
    right, stiff = comparison.models
    assert (right.name, stiff.name) == ("right", "stiff")
    side = data[2] - data[0]

    def cost(log):
        x = np.asarray(positions(float(np.exp(log))))
        return np.sum((x[2] - x[0] - side) ** 2)

    low, high = np.log([0.8 * E_TRUE, 1.25 * E_TRUE])
    best = np.exp(np.asarray(fminbound(cost, low, high, xtol=1e-8)).item())
    error = np.asarray(positions(float(best)))[:3] - data[:3]
    left = error[1] - 0.5 * (error[0] + error[2])
    up, other = right.folds[1], stiff.folds[1]
    np.testing.assert_allclose(up.noise_rms, np.sqrt(np.mean(left**2)) / STD, rtol=1e-2)
    np.testing.assert_allclose(up.rms, np.sqrt(np.sum(left**2) / 3), rtol=1e-2)
    assert other.noise_rms > 2.0 * up.noise_rms
