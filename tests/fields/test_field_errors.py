"""Standard errors of fields against closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

from softcal_jax.equilibrium import build_model
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    Parameter,
    ParameterSpace,
    field_standard_errors,
)
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam

MESH = beam(0.1, 0.02, 0.02, (4, 1, 1))
HALF = MESH.with_tet_group("left", np.flatnonzero(MESH.centroids[:, 0] < 0.05))
MODEL = build_model(HALF, NeoHookean(2e5, 0.4), density=1e3)
POINTS = ControlPoints({"a": (0.0, 0.01, 0.01), "b": (0.1, 0.01, 0.01)})


def shares(x):
    """Inverse squares of the distances from both control points, over their sum."""
    squares = np.sum((x[:, None] - np.asarray(POINTS.positions)[None]) ** 2, axis=2)
    return (1.0 / squares) / np.sum(1.0 / squares, axis=1, keepdims=True)


def spread(scale, **options):
    entry = ControlPointParameters(
        "E", POINTS, [2e5, 5e5], 1e5, 1e6, scale=scale, **options
    )
    return ParameterSpace((entry,))


COVARIANCE = np.array([[0.04, 0.012], [0.012, 0.09]])


def closed_form(weights, covariance):
    """Square root of sum w_i w_j c_ij, written out for two."""
    a, b = weights.T
    c = covariance
    return np.sqrt(a * a * c[0, 0] + 2.0 * a * b * c[0, 1] + b * b * c[1, 1])


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_two_control_points(scale):
    """Of a linear mix; dp/dz is the range of p, or on a log scale p itself."""
    space = spread(scale)
    errors = field_standard_errors(MODEL, space, space.start(), COVARIANCE)
    slopes = np.array([9e5, 9e5]) if scale == "linear" else np.array([2e5, 5e5])
    in_si = COVARIANCE * np.outer(slopes, slopes)
    expected = closed_form(shares(MESH.centroids), in_si)
    assert set(errors) == {"E"}
    np.testing.assert_allclose(errors["E"], expected, rtol=1e-12)


def test_regions_and_what_is_not_known():
    """A constant of the left half, one of the density, and none of its error there."""
    space = ParameterSpace(
        (
            Parameter("E left", "E", 3e5, 1e5, 1e6, region="left"),
            Parameter("nu", "nu", 0.4, 0.3, 0.45, scale="linear", S=0.1),
            Parameter("rho", "density", 1e3, 5e2, 2e3),
        )
    )
    covariance = np.diag([0.01, 0.25, 0.0])
    covariance[2, :] = covariance[:, 2] = np.nan
    errors = field_standard_errors(MODEL, space, space.start(), covariance)
    left = MESH.centroids[:, 0] < 0.05
    np.testing.assert_allclose(errors["E"], np.where(left, 0.1 * 3e5, 0.0), rtol=1e-12)
    np.testing.assert_allclose(errors["nu"], 0.1 * 0.5, rtol=1e-12)
    assert np.isnan(errors["density"]).all()


def test_all_unknown():
    """Nothing is known, nan everywhere, rather than zero."""
    space = spread("log")
    unknown = np.full((2, 2), np.nan)
    errors = field_standard_errors(MODEL, space, jnp.asarray(space.start()), unknown)
    assert np.isnan(errors["E"]).all()
