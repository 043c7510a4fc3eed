"""The scale of verdicts: what is asked for, whatever the bounds, and stated priors."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from judged import angle, judge, modulus
from wording import says

from softcal_jax.equilibrium import build_model
from softcal_jax.fields import (
    Parameter,
    ParameterSpace,
    clamp_stiffness,
    friction,
    gravity_tilt,
    load_factor,
    load_offset,
    marker_offset,
    motor_zero,
    mounting,
    recording_offset,
    shape_offset,
)
from softcal_jax.identifiability import identifiability
from softcal_jax.inference import independent
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import beam

LAW = Corotational(ReducedTransverseIsotropic(1e5, 1e5, 0.4, Fibre(0.0)))
MODEL = build_model(beam(0.1, 0.02, 0.02, (2, 1, 1)), LAW, density=1e3, solver="none")


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (0.0999, "identifiable"),
        (0.1001, "weakly identifiable"),
        (0.2999, "weakly identifiable"),
        (0.3001, "not identifiable"),
    ],
)
@pytest.mark.parametrize("ratio", [1.1, 100.0])
def test_thresholds(error, expected, ratio):
    """Relative standard errors at 10 and 30 %, whatever the bounds."""
    outlook = judge([[1.0 / error]], modulus(ratio=ratio))
    assert outlook.verdict == outlook.parameters[0].verdict == expected
    assert outlook.directions[0].verdict == expected
    assert outlook.parameters[0].relative == pytest.approx(error, rel=1e-9)


@pytest.mark.parametrize("upper", [1e5, 1e6])
def test_a_constant_known_to_44_percent_is_not_identifiable(upper):
    """A constant of Mooney and Rivlin of 33 kPa, with bounds from zero."""
    c2 = Parameter("c2", "c2", 33e3, 0.0, upper, scale="linear", unit="Pa")
    outlook = judge([[upper / (0.44 * 33e3)]], c2)
    assert outlook.verdict == "not identifiable"
    assert outlook.parameters[0].relative == pytest.approx(0.44)
    assert "bounds" not in str(outlook).replace("Bounds do not count as data", "")
    # Somebody may ask for less.
    half = judge([[upper / (0.44 * 33e3)]], c2, precision=0.5)
    assert half.verdict == "identifiable"


def test_the_text_does_not_depend_on_the_bounds():
    texts = [
        str(judge([[5.0, 1.0], [1.0, 4.0]], modulus(ratio=r), modulus("a")))
        for r in (2.0, 1e4)
    ]
    assert texts[0] == texts[1]


def test_a_stated_prior_counts_like_a_measurement():
    """Known to 5 % before: identifiable, though no data see it, and it says so."""
    known = replace(modulus(), prior_std=jnp.asarray(0.05))
    outlook = judge(np.zeros((3, 1)), known)
    assert outlook.verdict == "identifiable"
    assert outlook.parameters[0].data_only == np.inf
    assert outlook.informed == 0
    text = str(outlook)
    assert says(text, "prior", "counts")
    assert "from the data alone" in text
    assert "5 kPa (5 %)" in text
    assert says(text, "prior", "0 of 1 direction")
    assert judge([[30.0]], known).informed == 1  # 3.3 % by the data


@pytest.mark.parametrize(
    ("entry", "asked"),
    [
        (motor_zero("m", limit=0.2, prior_std=None), np.deg2rad(0.5)),
        (gravity_tilt(limit=0.2, prior_std=None)[0], np.deg2rad(1.0)),
        (recording_offset(limit=0.1, prior_std=None)[0], 0.5e-3),
        (mounting("b", (0.1, 0.0, 0.0), limit=0.1, prior_std=None)[0], 0.5e-3),
        (marker_offset("tip", limit=0.1, prior_std=None)[0], 0.5e-3),
        (friction("c", 0.2, limit=0.1, prior_std=None), 0.1),
        (shape_offset("wall", limit=0.1, prior_std=None), 0.2e-3),
        (load_factor(prior_std=None), 0.1),
        (load_offset(limit=0.1, prior_std=None)[0], 5e-3),
        (clamp_stiffness("x_min", 1e6, prior_std=None), 1e5),
        (Parameter("nu", "nu", 0.4, 0.0, 0.49, scale="linear"), 0.05),
        (Parameter("rho", "density", 1e3, 5e2, 2e3, unit="kg/m^3"), 100.0),
        (angle(), 0.1),
    ],
    ids=lambda value: getattr(value, "label", None),
)
def test_what_is_asked_of_each_kind(entry, asked):
    """The table of `softcal_jax.fields._start`, in SI units."""
    space = ParameterSpace((entry,))
    linear = independent(np.ones((1, 1)), tuple(space.names))
    outlook = identifiability(linear, space, space.start(), model=MODEL)
    assert outlook.parameters[0].asked == pytest.approx(asked)
    finer = identifiability(linear, space, space.start(), model=MODEL, precision=0.05)
    assert finer.parameters[0].asked == pytest.approx(0.5 * asked)


def test_a_value_of_zero_has_no_relative_error():
    c2 = Parameter("c2", "c2", 0.0, 0.0, 1e5, scale="linear", unit="Pa")
    outlook = judge([[10.0]], c2)
    assert outlook.verdict == "not identifiable"
    assert outlook.parameters[0].standard_error == pytest.approx(1e4)


def test_informed_directions_are_those_that_data_see_better_than_the_prior():
    """Singular values above 1 of the compliances per prior standard deviation."""
    W = np.random.default_rng(10).normal(size=(9, 5)) * np.logspace(-1, 2, 5)
    stds = np.array([0.3, 0.1, 0.2, 0.01, 0.05])
    parameters = [
        replace(modulus(name), prior_std=jnp.asarray(std))
        for name, std in zip("abcde", stds, strict=True)
    ]
    directions, singular, _ = np.linalg.svd(W * stds)
    expected = int(np.sum(singular > 1.0))
    assert judge(W, *parameters).informed == expected
    assert 0 < expected < 5
    # An error of what is held fixed may take the place of one of them.
    W_c = 100.0 * directions[:, [expected - 1]]
    assert judge(W, *parameters, W_c=W_c).informed == expected - 1
