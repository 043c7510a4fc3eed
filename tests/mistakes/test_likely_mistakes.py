"""Each kind of mistake is named on a quick robot, and nothing where all is right."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from wording import says

from benchmarks._planted_mistakes import (
    CHECKED,
    MISTAKES,
    Case,
    Robot,
    right,
    robots,
    with_forces,
)
from benchmarks.mistakes import _is
from softcal_jax.calibration import CalibrationResult, calibrate
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.mistakes import Mistake, likely_mistakes
from softcal_jax.project import implausible


@cache
def robot() -> Robot:
    """The cable beam: markers, a 6-D sensor, a thread and gravity."""
    (of_name,) = [r for r in robots() if r.name == "cable beam"]
    return of_name


def fitted(case: Case, space: ParameterSpace | None = None) -> CalibrationResult:
    return calibrate(
        robot().model,
        space or robot().space,
        case.poses,
        noise=robot().noise,
        intervals=None,
    )


LONG = "markers swapped in all poses", "frame mirrored", "longer clamp"
"""Mistakes that each take as long to find as several of the others."""


@pytest.mark.parametrize(
    "what",
    [pytest.param(w, marks=pytest.mark.slow) if w in LONG else w for w in MISTAKES],
)
def test_a_mistake_is_named_first(what):
    case = MISTAKES[what](robot(), np.random.default_rng(7))
    named = likely_mistakes(fitted(case))
    assert named, what
    assert _is(named[0], case), named[0].change
    assert named[0].rms_after < 0.5 * named[0].rms_before
    assert named[0].errors_after < named[0].errors_before


def test_nothing_is_named_where_nothing_is_wrong():
    assert likely_mistakes(fitted(right(robot(), np.random.default_rng(7)))) == ()


@pytest.mark.slow
def test_a_place_of_a_marker_that_is_hardly_off_is_no_mistake():
    """By 0.6 mm, where what is left is 0.2 mm rms: a model that errs may look so."""
    read = robot().measured(np.random.default_rng(7))
    off = np.array([[0.0, 0.0, 0.0], [0.0, 4e-4, 4e-4], [0.0, 0.0, 0.0]])
    case = Case(tuple(replace(c, measured=c.measured + off) for c in read))
    result = fitted(case)
    assert result.contradicted
    assert likely_mistakes(result) == ()


@pytest.mark.parametrize("what", CHECKED)
def test_geometry_tells_a_mistake_before_any_fit(what):
    """Also of a robot whose tip is a rigid body with a mass and a sensor."""
    case = CHECKED[what](robot(), np.random.default_rng(7))
    lines = implausible(robot().model, {c.name: c for c in case.poses})
    assert says(" ".join(lines), *case.words)


@pytest.mark.slow
def test_what_leaves_more_than_noise_is_no_mistake():
    """Gravity is stated across; reversed, it would leave 29 standard deviations."""
    read = robot().measured(np.random.default_rng(7))
    across = tuple(replace(c, gravity=(0.0, 9.81, 0.0)) for c in read)
    result = fitted(Case(across))
    assert result.contradicted
    assert likely_mistakes(result) == ()


def test_a_factor_on_all_forces_is_named_only_where_the_bounds_exclude_it():
    """A modulus makes up for it; with a modulus on its bound the data contradict it."""
    alone = [replace(c, gravity=(0.0, 0.0, 0.0), loads=()) for c in robot().poses]
    read = robot()._replace(poses=tuple(alone)).measured(np.random.default_rng(7))
    stated = tuple(with_forces(c, "actuation", 1 / 9.81) for c in read)
    names = {}
    for lower in (1e3, 1e5):
        space = ParameterSpace((Parameter("E", "E", 3e5, lower, 1e6, unit="Pa"),))
        result = fitted(Case(stated), space)
        names[lower] = [m.change for m in likely_mistakes(result)]
    assert names[1e3] == []
    assert "Multiplying the actuation by 9.81 in all poses" in names[1e5]


def test_a_result_without_points_speaks_of_standard_deviations():
    mistake = Mistake("wrong sign", "Reversing gravity", np.nan, np.nan, 40.0, 1.0)
    assert "from 40 standard deviations to 1 standard deviations" in str(mistake)
    mistake = Mistake("wrong sign", "Reversing gravity", 0.041, 9e-4, 40.0, 1.0)
    assert "from 41 mm to 0.9 mm" in str(mistake)
