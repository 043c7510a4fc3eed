"""The course of a fit and the error budget, as the page draws them."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from export.handmade import make_result
from wording import says

from softcal_jax.calibration import ParameterEstimate
from softcal_jax.report._charts import MOST_PARAMETERS, budget_chart, course_charts
from softcal_jax.report._verdict import end_of


def drawn(result):
    """The charts by their titles, after the words above them."""
    words, charts = course_charts(result)
    figures = re.findall(r"<figure>.*?</figure>", charts, re.S)
    titles = [re.findall(r"<strong>(.*?)</strong>", figure)[0] for figure in figures]
    return words, dict(zip(titles, figures, strict=True))


def values(chart, ticks):
    """Heights of the circles in the unit of the axis, by two of its lines."""
    y = {
        t: float(re.findall(f'y="([\\d.]+)">{re.escape(t)}<', chart)[0]) for t in ticks
    }
    low, high = ticks
    # The words stand three pixels above their line.
    of = lambda place: (place + -3.0 - y[low]) / (y[high] - y[low])
    places = [
        float(p) for p in re.findall(r'<circle cx="[\d.]+%" cy="([\d.]+)"', chart)
    ]
    return np.array([of(place) for place in places])


def test_what_is_drawn():
    """rms, lambda_p and each parameter, in units that are written above."""
    _, charts = drawn(make_result())
    rms, size, E, nu = charts
    assert says(rms, "markers", "rms [mm]")
    assert says(size, "Step size", "largest |lambda_p| [-]")
    assert (E, nu) == ("E [kPa]", "nu [-]")
    # As a share of the span of two lines of the grid, whose pixels are rounded.
    close: Any = {"atol": 2e-3}
    np.testing.assert_allclose(
        values(charts[rms], ("0", "2")), 2.0 / np.arange(1, 6), **close
    )
    steps = values(charts[size], ("1e-8", "1e0"))
    logs = np.log10([0.3, 0.1, 1e-3, 1e-8])
    np.testing.assert_allclose(steps, 1.0 + logs / 8.0, **close)
    assert "tolerance 1e-06" in charts[size]
    course = values(charts[E], ("200", "240"))
    np.testing.assert_allclose(course, [0.0, 0.25, 0.5, 0.75, 1.0], **close)
    assert says(charts[E], "240.0 ± 6.0 kPa", "100 kPa to 1 MPa")
    assert says(charts[nu], "0.44, on a bound")


def test_where_the_noise_is_estimated_a_line_is_drawn():
    """Between the steps 2 and 3, where the size of the step may jump."""
    result = make_result()
    pairs = zip(result.history, [1.0, 1.0, 1.0, 0.4, 0.4], strict=True)
    history = tuple(replace(entry, noise_level=level) for entry, level in pairs)
    words, charts = drawn(replace(result, history=history))
    assert "noise was re-estimated" in words
    # 2.5 of 4 steps, between 14 % and 96 % of the width.
    line = f'x1="{14 + 82 * 2.5 / 4:.2f}%"'
    assert all(line in chart and "2 4" in chart for chart in charts.values())
    assert not any("2 4" in chart for chart in drawn(result)[1].values())


def test_steps_that_were_not_taken_are_marked():
    words, charts = drawn(make_result(rejected=(2, 3)))
    assert says(words, "Open circles", "refused")
    assert [chart.count('fill="#ffffff"') for chart in charts.values()] == [2, 2, 2, 2]
    words, charts = drawn(make_result())
    assert "refused" not in words
    assert not any('fill="#ffffff"' in chart for chart in charts.values())


def test_only_the_start():
    """A calibration that stopped before its first step can still be drawn."""
    short = make_result(converged=False, history=make_result().history[:1])
    assert [chart.count("<circle") for chart in drawn(short)[1].values()] == [1, 1, 1]


def test_of_many_parameters_the_first_are_drawn():
    names = [f"E{i}" for i in range(9)]
    parameters = tuple(
        ParameterEstimate(n, 2e5, 1e3, 2e5, 1e5, 1e6, "Pa", False) for n in names
    )
    history = tuple(
        replace(entry, values=dict.fromkeys(names, 2e5))
        for entry in make_result().history
    )
    _, charts = drawn(make_result(parameters=parameters, history=history))
    assert len(charts) == 2 + MOST_PARAMETERS


def test_a_step_without_a_logarithm_can_be_drawn():
    history = tuple(
        replace(entry, lambda_p=(0.0, 0.0)) for entry in make_result().history
    )
    _, size, *_ = drawn(make_result(history=history))[1].values()
    assert "1e-16" in size


def ended(size=None, **changes):
    result = make_result(**changes)
    if size is not None:
        *before, last = result.history
        small = replace(last, lambda_p=(size,) * len(last.lambda_p))
        result = replace(result, history=(*before, small))
    return end_of(result)


def test_the_criterion_that_ended_the_fit_is_named():
    """Also where the last step stands above the tolerance, as nothing was to gain."""
    assert says(ended(), "|lambda_p| = 1.0e-08", "below 1e-06")
    assert says(ended(1.5e-6), "|lambda_p| = 1.5e-06", "reduce the cost", "less")
    assert says(ended(rejected=(4,)), "refused ... flat")
    assert "every step was refused" in ended(converged=False, rejected=(4,))
    assert ended() in [*drawn(make_result())[1].values()][1]


def test_bars_of_the_budget():
    """Of the variance of E 64 % are noise and 36 % clamp; nu has no standard error."""
    (chart,) = budget_chart(make_result())
    widths = [
        float(w) for w in re.findall(r'<rect y="1"[^>]* width="([\d.]+)%"', chart)
    ]
    assert widths == pytest.approx([64.0, 36.0], abs=1e-3)
    assert re.findall(r"</svg>(\w+)</li>", chart) == ["noise", "clamp"]
    assert "E = 240.0 ± 6.0 kPa" in chart
    assert "noise 64 %, clamp 36 %" in chart
    assert "nu = " not in chart
