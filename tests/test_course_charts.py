"""The course of a fit and the error budget, as charts and as the page shows them."""

from dataclasses import replace

import numpy as np
import pytest
from export.handmade import make_result
from matplotlib.figure import Figure
from wording import says

from softcal_jax.calibration import ParameterEstimate
from softcal_jax.plotting import draw_budget, draw_course
from softcal_jax.results._calibration import (
    MOST_PARAMETERS,
    budget_chart,
    course_charts,
    end_of,
)

NAMES = "rms", "lambda_p", "E", "nu"


def drawn(result, name, **options):
    """The axes, the curve's values, and the labels of the legend."""
    axes = draw_course(Figure().subplots(), result, name, **options)
    _, labels = axes.get_legend_handles_labels()
    curve = next(line for line in axes.lines if len(line.get_xdata()) == 5)
    return axes, np.asarray(curve.get_ydata()), labels


def test_what_is_drawn():
    """rms, lambda_p and each parameter, in units that are written beside the axis."""
    charts = {name: drawn(make_result(), name) for name in NAMES}
    axes, values, _ = zip(*charts.values(), strict=True)
    labels = [a.get_ylabel() for a in axes]
    assert labels == ["rms residual [mm]", "step size [-]", "E [kPa]", "nu [-]"]
    np.testing.assert_allclose(values[0], 4.0 / np.arange(1, 6))
    np.testing.assert_allclose(values[1][1:], [0.3, 0.1, 1e-3, 1e-8])
    np.testing.assert_allclose(values[2], [200.0, 210.0, 220.0, 230.0, 240.0])
    assert charts["lambda_p"][2] == ["tolerance 1e-06"]
    assert axes[1].get_yscale() == "log"


def test_what_is_true_and_what_is_on_a_bound():
    """In the unit of the axis; nu ends on its bound, and E does not."""
    axes, _, labels = drawn(make_result(), "E", truth=250e3)
    assert labels == ["true value"]
    assert axes.lines[-1].get_ydata() == pytest.approx([250.0, 250.0])
    axes, _, labels = drawn(make_result(), "nu")
    assert labels == ["on a bound"]
    np.testing.assert_allclose(axes.lines[-1].get_xydata(), [[4.0, 0.44]])


def test_where_the_noise_is_estimated_a_line_is_drawn():
    """Between the steps 2 and 3, where the size of the step may jump."""
    result = make_result()
    pairs = zip(result.history, [1.0, 1.0, 1.0, 0.4, 0.4], strict=True)
    history = tuple(replace(entry, noise_level=level) for entry, level in pairs)
    for name in NAMES:
        axes, *_ = drawn(replace(result, history=history), name)
        (line,) = [e for e in axes.lines if e.get_label() == "noise estimated anew"]
        assert list(line.get_xdata()) == [2.5, 2.5]
        assert "noise estimated anew" not in drawn(result, name)[2]


def test_steps_that_were_not_taken_are_marked():
    for name in NAMES:
        axes, values, _ = drawn(make_result(rejected=(2, 3)), name)
        (line,) = [e for e in axes.lines if e.get_label() == "step refused"]
        np.testing.assert_array_equal(line.get_xydata().T, [[2, 3], values[2:4]])
        assert line.get_markerfacecolor() == "white"
        assert "step refused" not in drawn(make_result(), name)[2]


def test_only_the_start():
    """A calibration that stopped before its first step can still be drawn."""
    short = make_result(converged=False, history=make_result().history[:1])
    assert len(course_charts(short)) == 3
    assert len(course_charts(make_result())) == 4


def test_of_many_parameters_the_first_are_drawn():
    names = [f"E{i}" for i in range(9)]
    parameters = tuple(
        ParameterEstimate(n, 2e5, 1e3, 2e5, 1e5, 1e6, "Pa", False) for n in names
    )
    history = tuple(
        replace(entry, values=dict.fromkeys(names, 2e5))
        for entry in make_result().history[:1]
    )
    result = make_result(parameters=parameters, history=history)
    assert len(course_charts(result)) == 1 + MOST_PARAMETERS


def test_a_step_without_a_logarithm_can_be_drawn():
    history = tuple(
        replace(entry, lambda_p=(0.0, 0.0)) for entry in make_result().history
    )
    assert drawn(make_result(history=history), "lambda_p")[1].min() == 1e-16


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
    said = " ".join(chart.caption for chart in course_charts(make_result()))
    assert says(
        said, ended(), "240.0 ± 6.0 kPa", "100 kPa to 1 MPa", "0.44, on a bound"
    )


def test_bars_of_the_budget():
    """Of the variance of E 64 % are noise and 36 % clamp; nu has no standard error."""
    axes = draw_budget(Figure().subplots(), make_result())
    assert [bar.get_width() for bar in axes.patches] == pytest.approx([64.0, 36.0])
    assert axes.get_legend_handles_labels()[1] == ["noise", "clamp"]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["E"]
    (chart,) = budget_chart(make_result())
    assert "Sources of the standard errors" in chart
