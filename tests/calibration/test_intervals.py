"""Intervals by profile likelihood: closed forms, bounds, lower costs, bad input."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import t

from softcal_jax.calibration import (
    LowerCostFound,
    calibrate,
    profile_ends,
    profile_intervals,
    simulated_measurements,
    synthetic_measurements,
)
from softcal_jax.calibration._calibrate import build_problem
from softcal_jax.calibration._profile import _bracket, _NotConverged, in_plain_steps
from softcal_jax.configurations import Configuration, Markers
from softcal_jax.equilibrium import build_model
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import beam
from softcal_jax.robots import anisotropic_beam

MESH = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)
MODEL = build_model(MESH, Corotational(Isotropic(400e3, 0.3)), density=1.0)
STD = 0.3e-6
"""A fifth of how far the tip sinks, of a body so light that it stays linear [m]."""


def measured(noise=0.5):
    """A marker whose height is off by some standard deviations."""
    pose = Configuration(
        "hanging",
        "x_min",
        markers=Markers(["tip"], [(0.1, 0.01, 0.01)], STD),
    )
    (pose,) = simulated_measurements(MODEL, [pose])
    moved = np.array(pose.measured) + noise * STD * np.array([[0.3, -0.2, 0.5]])
    return replace(pose, measured=moved)


def modulus(prior_std=None, upper=1e8):
    return Parameter("E", "E", 300e3, 1e3, upper, unit="Pa", prior_std=prior_std)


@pytest.fixture(scope="module")
def pose():
    return measured()


@pytest.fixture(scope="module")
def result(pose):
    return calibrate(MODEL, modulus(), pose, noise="stated")


def sink(result):
    """Motion of the marker in the best fit, in units of the noise [-]."""
    fit = result.configurations[0]
    return np.linalg.norm(fit.after - fit.at_rest) / STD


def test_of_a_compliance_it_is_symmetric_in_its_inverse(result, pose):
    """u = a / E is linear: 1 / E_end = (1 +- 1.96 / |u|) / E, in noise units."""
    (found,) = profile_intervals(result, pose)
    size = sink(result)
    assert 3.0 < size < 30.0  # far from where a first-order interval would hold
    expected = result.value("E") / (1.0 + np.array([1.0, -1.0]) * 1.959964 / size)
    np.testing.assert_allclose([found.lower, found.upper], expected, rtol=5e-3)
    assert (found.lower_end, found.upper_end) == ("likelihood", "likelihood")
    assert (found.name, found.level, found.unit) == ("E", 0.95, "Pa")


def test_level_widens_it(result, pose):
    (found,) = profile_intervals(result, pose, level=0.6826895)
    size = sink(result)
    expected = result.value("E") / (1.0 + np.array([1.0, -1.0]) / size)
    np.testing.assert_allclose([found.lower, found.upper], expected, rtol=5e-3)


def test_estimated_noise_takes_the_law_of_student(pose):
    """Three coordinates and one parameter leave two degrees of freedom."""
    result = calibrate(MODEL, modulus(), pose)
    (found,) = profile_intervals(result, pose)
    scale = result.uncertainty.noise_scale
    reach = t.ppf(0.975, 2) * scale / sink(result)
    expected = result.value("E") / (1.0 + np.array([1.0, -1.0]) * reach)
    np.testing.assert_allclose([found.lower, found.upper], expected, rtol=5e-3)


@pytest.mark.slow  # with a prior it is another program
def test_prior_counts_as_a_datum(pose):
    """One that leaves the data nothing to say: 1.96 of its own standard deviations."""
    result = calibrate(MODEL, modulus(1e-3), pose, noise="stated")
    (found,) = profile_intervals(result, pose)
    ends = np.log([found.lower, found.upper]) - np.log(result.value("E"))
    np.testing.assert_allclose(ends, [-1.96e-3, 1.96e-3], rtol=1e-2)


def test_it_ends_at_a_bound_that_the_data_do_not_exclude(pose):
    result = calibrate(MODEL, modulus(upper=410e3), pose, noise="stated")
    (found,) = profile_intervals(result, pose)
    assert found.upper_end == "bound"
    np.testing.assert_allclose(found.upper, 410e3, rtol=1e-12)
    assert found.lower_end == "likelihood"
    assert "410 (bound) kPa" in str(found)
    assert str(found) in str(replace(result, intervals=(found,)))


def test_a_lower_cost_is_no_interval(result, pose):
    """The fit is told to be where it is not, up the side of its own valley."""
    problem = build_problem(result.model, result.space, pose, result.newton)
    W, cost = np.asarray(result.W_ep), result.history[-1].cost
    off = result.z + 3.0 / np.linalg.norm(W)
    with pytest.raises(LowerCostFound, match="not in the best optimum") as caught:
        profile_ends(problem, result.settings, off, W, cost + 4.5, 1.96, [0])
    assert caught.value.z[0] < off[0]


@pytest.mark.slow  # with other settings it is another program
def test_fits_that_do_not_converge_give_no_end(result, pose):
    short = replace(result, settings=replace(result.settings, max_steps=1))
    (found,) = profile_intervals(short, pose)
    assert np.isnan(found.lower)
    assert found.lower_end == "not converged"
    assert str(found).startswith("not found to ")


def test_a_fit_that_is_lost_is_gone_back_from():
    """Beyond 1.4 no fit converges; the end is at 1.2, or at 1.5."""

    def excess(end):
        def of(distance):
            if distance > 1.4:
                raise _NotConverged
            return distance - end

        return of

    inside, outside = _bracket(excess(1.2), 1.2, 2.0, 10.0)
    assert inside <= 1.2 <= outside <= 1.4
    with pytest.raises(_NotConverged):
        _bracket(excess(1.5), 1.5, 2.0, 10.0)
    assert _bracket(excess(1.2), 1.2, 2.0, 1.1) is None


def test_bad_input(result, pose):
    with pytest.raises(ValueError, match=r"level must lie between 0 and 1.*got 95"):
        profile_intervals(result, pose, level=95.0)
    with pytest.raises(ValueError, match="unknown parameter 'EE'"):
        profile_intervals(result, pose, parameters=["EE"])
    with pytest.raises(ValueError, match="did not converge"):
        profile_intervals(replace(result, converged=False), pose)
    with pytest.raises(ValueError, match="give those that were calibrated"):
        profile_intervals(result, measured(noise=5.0))


def test_estimated_noise_needs_data_and_no_prior(result, pose):
    estimated = replace(result.uncertainty, noise="estimated")
    known = replace(result, uncertainty=estimated, space=with_prior(result.space))
    with pytest.raises(ValueError, match="beside a prior"):
        profile_intervals(known, pose)
    none = replace(result, uncertainty=replace(estimated, degrees_of_freedom=0))
    with pytest.raises(ValueError, match="more measured coordinates"):
        profile_intervals(none, pose)


def with_prior(space):
    """So weak that the cost is the same."""
    return ParameterSpace([replace(q, prior_std=1e6) for q in space.parameters])


@pytest.mark.slow  # two programs of a beam with axes, each of several fits
def test_where_both_moduli_meet_an_end_is_found():
    """E_t cannot fall below E_l: beyond, the axis would turn by 90 degrees."""
    setup = anisotropic_beam(cells=(3, 1, 1), std=1e-3)
    poses = synthetic_measurements(
        setup.model, setup.space, setup.configurations, setup.target
    )
    start = jnp.asarray([setup.target[name] for name in setup.space.names])
    result = calibrate(
        setup.model,
        setup.space,
        poses,
        noise="stated",
        start=setup.space.to_scaled(start),
    )
    name = next(name for name in setup.space.names if name.startswith("E_t"))
    (found,) = profile_intervals(result, poses, parameters=[name])
    assert found.lower_end == "likelihood"
    assert found.lower < result.value(name) < found.upper


def test_plain_steps_keep_the_order_of_the_moduli():
    space = anisotropic_beam(cells=(2, 1, 1)).space
    plain = in_plain_steps(space)
    assert space.chart is not None
    assert plain.chart is None
    assert plain.order == (("E_l", "E_t"),)
    assert plain.names == space.names
    assert eqx.tree_equal(plain.entries, space.entries)
