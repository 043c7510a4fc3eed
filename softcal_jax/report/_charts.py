"""Charts of a page; shapes or words repeat what colours distinguish.

They are SVG whose text keeps its size, however wide the page is: places along the width
are percentages, and those along the height pixels.
"""

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from softcal_jax._units import readable, readable_unit
from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    ParameterEstimate,
)
from softcal_jax.report._html import Html, figure, joined, node
from softcal_jax.report._tables import distance
from softcal_jax.report._verdict import end_of

INK, BLUE, LINE, PAPER = "#1a1a1a", "#0b4f8a", "#c8c8c8", "#ffffff"

MOST_PARAMETERS = 7  # parameters whose course is drawn
# Where a chart over an axis begins and ends, its labels stand, and its height.
_TOP, _BOTTOM, _LABELS, _HEIGHT = 30.0, 170.0, 190.0, 196
MOST_BARS = 24  # rows of a chart
LEAST_NAMED = 0.01  # share of a variance of which the cause is named beside the bar [-]

# Darker and lighter in turn, so that neighbours differ in grey as well. Where there are
# more causes, the colours repeat.
_FILLS = ("#8c8c8c", "#0b4f8a", "#f0b27a", "#1b7a5a", "#d9cdf0", "#5b4310", "#ffffff")


def error_chart(fits: Sequence[ConfigurationResult]) -> list[Html]:
    """Draw errors before and after beside the motion, one row per configuration."""
    shown = [fit for fit in fits if math.isfinite(fit.rms_after)]
    sizes = [v for f in shown for v in (f.rms_before, f.rms_after, f.motion)]
    longest = max((v for v in sizes if math.isfinite(v)), default=0.0)
    if longest == 0.0:
        return []
    rows = [_errors(fit, longest) for fit in shown]
    caption = (
        "Root mean square distance between simulated and measured markers, with the "
        "start values (open circle) and the calibrated values (filled circle). The "
        "vertical line is the motion of the markers. All rows have the same scale, "
        f"from 0 to {distance(longest)}."
    )
    return [figure(joined(rows), caption)]


def workspace_chart(fits: Sequence[ConfigurationResult]) -> list[Html]:
    """Draw the errors after calibration at the places where the markers are.

    Each configuration is at the mean place of its simulated points, in the plane in
    which these means differ most.
    """
    shown = [fit for fit in fits if math.isfinite(fit.rms_after)]
    if not shown:
        return []
    points = [[e.simulated for e in fit.points] for fit in shown]
    places = 1e3 * np.array([np.mean(of_pose, axis=0) for of_pose in points])
    across, up = np.sort(np.argsort(-np.ptp(places, axis=0), kind="stable")[:2])
    worst = max(fit.rms_after for fit in shown) or 1.0
    low, size = places.min(axis=0), np.maximum(np.ptp(places, axis=0), 1e-9)
    parts = []
    for fit, place in zip(shown, (places - low) / size, strict=True):
        look = {"fill": BLUE if fit.role == "validation" else PAPER, "stroke": BLUE}
        look |= {"cx": f"{8 + 84 * place[across]:.2f}%", "fill_opacity": "0.6"}
        r = f"{2.0 + 10.0 * fit.rms_after / worst:.1f}"
        parts.append(node("circle", cy=f"{240 - 220 * place[up]:.1f}", r=r, **look))
    title = "Errors over the workspace"
    drawn = node("svg", *parts, role="img", aria_label=title, height="260")
    spans = [
        f"{'xyz'[k]} from {low[k]:.0f} to {low[k] + size[k]:.0f} mm"
        for k in (across, up)
    ]
    caption = (
        f"Horizontal axis: {spans[0]}; vertical axis: {spans[1]}. Each circle is the "
        "mean position of the points of a configuration, and its size is the error, up "
        f"to {distance(worst)}. Filled circles were held out."
    )
    return [figure(drawn, caption, title=title)]


def _errors(fit: ConfigurationResult, longest: float) -> Html:
    """Draw one row, with its numbers in words."""
    x = lambda value: f"{2.0 + 96.0 * value / longest:.2f}%"
    parts = [_line("2%", 14, "98%", 14, stroke=LINE)]
    before, after = "no equilibrium before the fit", x(fit.rms_after)
    if math.isfinite(fit.motion):
        moved = x(fit.motion)
        parts.append(_line(moved, 3, moved, 25, stroke=INK, stroke_width="3"))
    if math.isfinite(fit.rms_before):
        start = x(fit.rms_before)
        parts.append(_line(after, 14, start, 14, stroke=BLUE, stroke_width="3"))
        parts.append(_circle(start, 14, filled=False))
        before = f"{distance(fit.rms_before)} before the fit"
    parts.append(_circle(after, 14))
    held = " (held out)" if fit.role == "validation" else ""
    words = f"{before}, {distance(fit.rms_after)} after; motion {distance(fit.motion)}"
    return _row(f"{fit.name}{held}", parts, words)


def budget_chart(result: CalibrationResult) -> list[Html]:
    """Draw the share of each cause in the variance of each parameter."""
    squares = {cause: std**2 for cause, std in result.budget.by_cause().items()}
    total = np.asarray(sum(squares.values()))
    known = np.flatnonzero(np.isfinite(total) & (total > 0.0))
    if not known.size:
        return []
    shares = {cause: square[known] / total[known] for cause, square in squares.items()}
    bars = [
        _bar(result.parameters[i], {c: float(share[k]) for c, share in shares.items()})
        for k, i in enumerate(known[:MOST_BARS])
    ]
    # Colours repeat, so the legend leaves out causes that are too thin to be seen.
    entries = []
    for k, (cause, share) in enumerate(shares.items()):
        if max(share) >= LEAST_NAMED:
            swatch = _filled(k, x="0", y="0", width="28", height="16")
            drawn = node("svg", swatch, height="16", aria_hidden="true")
            entries.append(node("li", drawn, cause))
    legend = node("ul", *entries, class_="legend")
    caption = (
        "Sources of the standard error of each parameter, as shares of its variance. "
        "The source with the longest bar is the first to measure better."
    )
    if len(known) > MOST_BARS:
        caption += f" Only in the table: {len(known) - MOST_BARS} more."
    return [figure(joined([legend, *bars]), caption)]


def _bar(parameter: ParameterEstimate, shares: Mapping[str, float]) -> Html:
    parts, left = [], 0.0
    for k, share in enumerate(shares.values()):
        place = {"x": f"{100.0 * left:.3f}%", "width": f"{100.0 * share:.3f}%"}
        parts.append(_filled(k, y="1", height="22", **place))
        left += share
    ranked = sorted(shares.items(), key=lambda item: -item[1])
    named = (f"{c} {100 * s:.0f} %" for c, s in ranked if s >= LEAST_NAMED)
    title = f"{parameter.name} = {parameter}"
    return _row(title, parts, ", ".join(named), height=24)


def _filled(k: int, **place: str) -> Html:
    return node("rect", **place, fill=_FILLS[k % len(_FILLS)], stroke=INK)


def _row(title: str, parts: Sequence[Html], words: str, *, height: int = 28) -> Html:
    """Put a chart of one row between its title and its numbers in words."""
    drawn = node("svg", *parts, height=str(height), aria_hidden="true")
    head = node("p", node("strong", title))
    return node("div", head, drawn, node("p", words), class_="row")


def _line(x1: str, y1: float, x2: str, y2: float, **look: str) -> Html:
    return node("line", x1=x1, y1=f"{y1:.1f}", x2=x2, y2=f"{y2:.1f}", **look)


def _circle(x: str, y: float, *, filled: bool = True) -> Html:
    look = {"fill": BLUE if filled else PAPER, "stroke": BLUE, "stroke_width": "2"}
    return node("circle", cx=x, cy=f"{y:.1f}", r="5", **look)


def _text(words: str, x: str, y: float, **look: str) -> Html:
    return node("text", words, x=x, y=f"{y:.1f}", **look)


def course_charts(result: CalibrationResult) -> list[Html]:
    """Draw the fit, the size of the step and the parameters against the steps."""
    drawn = [_fit(result)]
    if len(result.history) > 1:
        drawn.append(_step_size(result))
    drawn += [_parameter(result, q) for q in result.parameters[:MOST_PARAMETERS]]
    charts = node("div", *drawn, class_="charts")
    words = "Each curve is plotted against the step number; step 0 is the start."
    if not all(entry.accepted for entry in result.history):
        words += " Open circles: steps that were refused."
    if _noise_changes(result):
        words += " Dotted line: the noise was re-estimated here."
    return [node("p", words), charts]


def _fit(result: CalibrationResult) -> Html:
    fitted = [fit for fit in result.configurations if fit.role == "calibration"]
    title = "Residual of the markers, rms [mm]"
    values = [1e3 * entry.rms for entry in result.history]
    if not any(fit.points for fit in fitted):  # lengths, angles or forces alone
        title, values = "Cost [-]", [entry.cost for entry in result.history]
    ticks = _round_ticks([0.0, *filter(math.isfinite, values)])
    return _curve(result, title, values, ticks)


def _step_size(result: CalibrationResult) -> Html:
    """Draw log10 of the largest lambda_p, and the tolerance."""
    # A step of exactly zero has no logarithm; it is drawn at the level of rounding.
    steps = [max(*map(abs, entry.lambda_p), 1e-16) for entry in result.history]
    values, tol = [math.log10(step) for step in steps], result.settings.tol
    level = {math.log10(tol): f"tolerance {tol:g}"}
    ends = [*values[1:], *level]
    low, high = math.floor(min(ends)), math.ceil(max(ends))
    every = max(1, math.ceil((high - low) / 5))
    ticks = {float(k): f"1e{k}" for k in range(low, high + 1, every)}
    title = "Step size, largest |lambda_p| [-]"
    return _curve(result, title, values, ticks, level, end_of(result))


def _parameter(result: CalibrationResult, q: ParameterEstimate) -> Html:
    series = [entry.values[q.name] for entry in result.history]
    factor, unit = readable_unit(series, q.unit)
    values = [factor * value for value in series]
    bounds = f"{readable(q.lower, q.unit)} to {readable(q.upper, q.unit)}"
    words = f"Ends at {q}{', on a bound' if q.at_bound else ''}; bounds {bounds}."
    title = f"{q.name} [{unit or '-'}]"
    return _curve(result, title, values, _round_ticks(values), caption=words)


def _curve(
    result: CalibrationResult,
    title: str,
    values: Sequence[float],
    ticks: Mapping[float, str],
    level: Mapping[float, str] = {},
    caption: str = "",
) -> Html:
    """Draw a number over the steps, in the unit of the title.

    `ticks` are grid lines, `level` is a value to be reached, each with its label.
    """
    history = result.history
    last = max(history[-1].step, 1)
    ends = [*ticks, *level]
    low, high = min(ends), max(ends)
    x = lambda step: f"{14.0 + 82.0 * step / last:.2f}%"
    y = lambda v: _BOTTOM - (_BOTTOM - _TOP) * (v - low) / (high - low or 1.0)
    parts = []
    for value, label in ticks.items():
        parts.append(_line("0", y(value), "100%", y(value), stroke=LINE))
        parts.append(_text(label, "0", y(value) - 3))
    for value, label in level.items():
        look = {"stroke": INK, "stroke_dasharray": "6 4", "stroke_width": "1.5"}
        parts.append(_line("0", y(value), "100%", y(value), **look))
        # On the left, where a curve that falls to the level is still far from it.
        parts.append(_text(label, "12%", y(value) - 4))
    for step in _noise_changes(result):
        look = {"stroke": INK, "stroke_dasharray": "2 4"}
        parts.append(_line(x(step), _TOP, x(step), _BOTTOM, **look))
    pairs = zip(history, values, strict=True)
    known = [(entry, value) for entry, value in pairs if math.isfinite(value)]
    places = [(x(entry.step), y(value)) for entry, value in known]
    for start, end in itertools.pairwise(places):
        parts.append(_line(*start, *end, stroke=BLUE, stroke_width="2"))
    for (entry, _), place in zip(known, places, strict=True):
        parts.append(_circle(*place, filled=entry.accepted))
    for step in range(0, last + 1, max(1, math.ceil(last / 10))):
        parts.append(_text(str(step), x(step), _LABELS, text_anchor="middle"))
    words = f"{title}, after each step"
    drawn = node("svg", *parts, role="img", aria_label=words, height=str(_HEIGHT))
    return figure(drawn, caption, title=title)


def _noise_changes(result: CalibrationResult) -> list[float]:
    """Return the places between steps at which the noise was estimated anew."""
    return [
        0.5 * (before.step + entry.step)
        for before, entry in itertools.pairwise(result.history)
        if not math.isclose(before.noise_level, entry.noise_level)
    ]


def _round_ticks(values: Sequence[float]) -> dict[float, str]:
    """Choose round numbers around values, for about three lines of a grid."""
    from matplotlib.ticker import MaxNLocator

    low, high = min(values), max(values)
    if high - low <= 1e-9 * max(abs(low), abs(high)):  # equal up to rounding
        margin = 0.05 * max(abs(low), abs(high)) or 1.0
        low, high = low - margin, high + margin
    ticks = MaxNLocator(3, steps=[1, 2, 5, 10]).tick_values(low, high)
    return {float(tick): f"{tick:.6g}" for tick in ticks}
