"""Charts of a calibration on its page."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from softcal_jax import plotting
from softcal_jax._units import readable
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.report._html import CHART, Html, chart, node
from softcal_jax.report._verdict import end_of, listed_fits

MOST_PARAMETERS = 7  # parameters whose course is drawn
MOST_BARS = 24  # rows of a chart
_SMALL = plotting.PictureStyle(width_mm=100.0, font_size=10.0)


def error_charts(fits: Sequence[ConfigurationResult]) -> list[Html]:
    """Draw errors before and after beside the motion; of many poses, where they are."""
    listed = listed_fits(fits)
    rows = sum(math.isfinite(fit.rms_after) for fit in listed)
    if not rows:
        return []
    caption = "Root mean square distance between simulated and measured markers."
    draw = partial(plotting.draw_errors, fits=listed)
    charts = [_drawn("Errors of the markers", draw, caption, rows=rows)]
    if len(listed) < len(fits):
        caption = (
            "Each circle is at the mean position of the points of a configuration."
        )
        draw = partial(plotting.draw_workspace, fits=fits)
        charts.append(_drawn("Errors over the workspace", draw, caption))
    return charts


def budget_chart(result: CalibrationResult) -> list[Html]:
    """Draw the share of each cause in the variance of each parameter."""
    total = np.sum([std**2 for std in result.budget.by_cause().values()], axis=0)
    rows = min(int(np.sum(np.isfinite(total) & (total > 0.0))), MOST_BARS)
    caption = "The source with the longest bar is the first to measure better."
    draw = partial(plotting.draw_budget, result=result, most=MOST_BARS)
    title = "Sources of the standard errors"
    return [_drawn(title, draw, caption, rows=rows)] if rows else []


def course_charts(result: CalibrationResult) -> list[Html]:
    """Draw the fit, the size of the step and the parameters against the steps."""
    fitted = [fit for fit in result.configurations if fit.role == "calibration"]
    # Lengths, angles or forces alone have no distance.
    charts = {"rms" if any(fit.points for fit in fitted) else "cost": ""}
    if len(result.history) > 1:
        charts["lambda_p"] = end_of(result)
    for q in result.parameters[:MOST_PARAMETERS]:
        bounds = f"{readable(q.lower, q.unit)} to {readable(q.upper, q.unit)}"
        at_bound = ", on a bound" if q.at_bound else ""
        charts[q.name] = f"Ends at {q}{at_bound}; bounds {bounds}."
    course = partial(plotting.draw_course, result=result)
    drawn = (
        _drawn(name, partial(course, name=name), words, style=_SMALL)
        for name, words in charts.items()
    )
    return [node("div", *drawn, class_="charts")]


def _drawn(
    title: str,
    draw: Callable[..., Any],
    caption: str,
    *,
    rows: int | None = None,
    style: plotting.PictureStyle = CHART,
) -> Html:
    """Draw a chart, as high as its rows need where it has any."""
    lines = None if rows is None else 2.0 + 1.6 * rows
    about = {"drawn": [draw], "lines": lines, "style": style}
    return chart(partial(plotting.plot_panels, **about), title, caption)
