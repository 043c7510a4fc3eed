"""Charts of a page as SVG whose text keeps its size, however wide the page is.

Places along the width are percentages, and those along the height pixels. What colours
tell apart, shapes, patterns or words tell apart as well.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    HistoryEntry,
    ParameterEstimate,
)
from softcal_jax.control import GoalFit
from softcal_jax.identifiability import Identifiability, percent
from softcal_jax.plotting import budget_shares
from softcal_jax.report._calibration import distance
from softcal_jax.report._html import Html, figure, joined, node

MOST_BARS = 24
"""Most parameters that get a bar."""

MOST_ROWS = 8
"""Most values of an axis that get a row each where they are numbers."""

LEAST_NAMED = 0.01
"""Share of a variance from which on a cause is named beside the bar [-]."""

_LEFT, _RIGHT = 14.0, 96.0
"""Where the first and the last step stand, in percent of the width."""

_INK, _BLUE, _LINE = "#1a1a1a", "#0b4f8a", "#c8c8c8"

# Paper and ink, darker and lighter in turn, so that neighbours differ in grey as well.
_PATTERNS = (
    ("#8c8c8c", "#8c8c8c", ""),
    ("#0b4f8a", "#0b4f8a", ""),
    ("#ffffff", "#d95f02", "M-2 2L2 -2M0 8L8 0M6 10L10 6"),
    ("#1b7a5a", "#ffffff", "M0 2H8M0 6H8"),
    ("#efe7f7", "#5a3d8a", "M2 0V8M6 0V8"),
    ("#5b4310", "#f6e3b0", "M-2 6L2 10M0 0L8 8M6 -2L10 2"),
    ("#ffffff", "#1a1a1a", "M0 4H8M4 0V8"),
)
"""Fills of the causes: background, colour of the lines, and the lines."""


def error_chart(fits: Sequence[ConfigurationResult]) -> list[Html]:
    """Draw errors before and after beside the motion, one row per configuration."""
    shown = [fit for fit in fits if fit.points]
    sizes = [v for f in shown for v in (f.rms_before, f.rms_after, f.motion)]
    longest = max((v for v in sizes if math.isfinite(v)), default=0.0)
    if longest == 0.0:
        return []
    rows = [_errors(fit, longest) for fit in shown]
    caption = (
        "Root mean square distance of the simulated from the measured markers, with "
        "the start values (open circle) and the calibrated ones (filled circle). The "
        "upright line is how far the markers moved. All rows have the same scale, from "
        f"0 to {distance(longest)}."
    )
    return [figure(joined(rows), caption)]


def _errors(fit: ConfigurationResult, longest: float) -> Html:
    """Draw one row, with its numbers in words."""
    x = lambda metres: f"{2.0 + 96.0 * metres / longest:.2f}%"
    parts = [_line("2%", 14, "98%", 14, stroke=_LINE)]
    if math.isfinite(fit.motion):
        ends = {"stroke": _INK, "stroke_width": "3"}
        parts.append(_line(x(fit.motion), 4, x(fit.motion), 24, **ends))
    if math.isfinite(fit.rms_before):
        ends = {"stroke": _BLUE, "stroke_width": "3"}
        parts.append(_line(x(fit.rms_after), 14, x(fit.rms_before), 14, **ends))
        parts.append(_circle(x(fit.rms_before), 14, "#ffffff"))
    parts.append(_circle(x(fit.rms_after), 14, _BLUE))
    held = " (held out)" if fit.role == "validation" else ""
    before = (
        f"{distance(fit.rms_before)} before"
        if math.isfinite(fit.rms_before)
        else "no equilibrium before"
    )
    words = f"{before}, {distance(fit.rms_after)} after, moved {distance(fit.motion)}"
    return _row(f"{fit.name}{held}", parts, 28, words)


def budget_chart(result: CalibrationResult) -> list[Html]:
    """Draw the share of each cause in the variance of each parameter."""
    shares = budget_shares(result)
    known = [
        (i, q)
        for i, q in enumerate(result.parameters)
        if sum(own[i] for own in shares.values()) > 0.0
    ]
    if not known:
        return []
    patterns = (_pattern(k) for k in range(min(len(shares), len(_PATTERNS))))
    defined = node("svg", node("defs", *patterns), class_="defs", aria_hidden="true")
    bars = [
        _bar(parameter, {cause: float(share[i]) for cause, share in shares.items()})
        for i, parameter in known[:MOST_BARS]
    ]
    legend = node("ul", *map(_entry, range(len(shares)), shares), class_="legend")
    caption = (
        "Where the standard error of each parameter comes from: share of each cause in "
        "its square. The longest part is what to measure better first."
    )
    if len(known) > MOST_BARS:
        caption += f" {len(known) - MOST_BARS} more parameters are in the table."
    return [figure(joined([defined, legend, *bars]), caption)]


def _bar(parameter: ParameterEstimate, shares: dict[str, float]) -> Html:
    parts, left = [], 0.0
    for k, share in enumerate(shares.values()):
        place = {"x": f"{100.0 * left:.3f}%", "width": f"{100.0 * share:.3f}%"}
        parts.append(_filled(k, y="1", height="22", **place))
        left += share
    ranked = sorted(shares.items(), key=lambda own: -own[1])
    named = (f"{c} {100 * s:.0f} %" for c, s in ranked if s >= LEAST_NAMED)
    return _row(_titled(parameter), parts, 24, ", ".join(named))


def _row(title: str, parts: Sequence[Html], height: int, words: str) -> Html:
    """Put a chart of one row between its title and the same in words."""
    return node(
        "div",
        node("p", node("strong", title)),
        node("svg", *parts, height=str(height), aria_hidden="true"),
        node("p", words),
        class_="row",
    )


def _titled(parameter: ParameterEstimate) -> str:
    return f"{parameter.name} = {parameter}"


def _entry(k: int, cause: str) -> Html:
    swatch = _filled(k, x="0", y="0", width="28", height="16")
    return node("li", node("svg", swatch, height="16", aria_hidden="true"), cause)


def _filled(k: int, **place: str) -> Html:
    fill = f"url(#cause{k % len(_PATTERNS)})"
    return node("rect", **place, fill=fill, stroke=_INK, stroke_width="1")


def _pattern(k: int) -> Html:
    paper, ink, lines = _PATTERNS[k]
    return node(
        "pattern",
        node("rect", width="8", height="8", fill=paper),
        node("path", d=lines, stroke=ink, stroke_width="2"),
        id=f"cause{k}",
        width="8",
        height="8",
        patternUnits="userSpaceOnUse",
    )


def outlook_chart(found: Identifiability) -> list[Html]:
    """Draw the standard error to expect of each parameter over the asked one."""
    rows = [
        _Ratio(p.name, p.ratio, f"{percent(p.ratio)} of the asked one: {p.verdict}")
        for p in found.parameters
    ]
    caption = (
        "Standard error to expect of each parameter, on one logarithmic scale. The "
        "upright line is the asked one; a point on its right is not known as well."
    )
    return _ratios(rows, caption)


def goal_chart(goals: Iterable[tuple[str, GoalFit]], tol: float) -> list[Html]:
    """Draw how far effectors are from their goals over what counts as met.

    Args:
        goals: What to call each, and how close it came.
        tol: Error at which a goal counts as met, in standard deviations [-].
    """
    rows = []
    for title, fit in goals:
        error = float(np.max(np.abs(fit.in_std), initial=0.0))
        words = f"off by {fit.off}, {error:.2g} standard deviations"
        rows.append(_Ratio(title, error / tol, words))
    caption = (
        "How far each effector is from its goal, on one logarithmic scale. The upright "
        "line is what counts as met; a point on its right is off by more."
    )
    return _ratios(rows, caption)


class _Ratio(NamedTuple):
    """A row of `_ratios`: title, what is drawn, and the same in words."""

    title: str
    ratio: float
    words: str


def _ratios(rows: Sequence[_Ratio], caption: str) -> list[Html]:
    """Draw a row with a point for each ratio, on one scale with a line at 1."""
    if not rows:
        return []
    # Within four decades of 1: there zero and infinity end.
    logs = [math.log10(min(max(own.ratio, 1e-4), 1e4)) for own in rows]
    low, high = min([*logs, -1.0]), max([*logs, 1.0])
    x = lambda log: f"{2.0 + 96.0 * (log - low) / (high - low):.2f}%"
    drawn = []
    for own, log in list(zip(rows, logs, strict=True))[:MOST_BARS]:
        parts = [
            _line("2%", 14, "98%", 14, stroke=_LINE),
            _line(x(0.0), 2, x(0.0), 26, stroke=_INK, stroke_width="3"),
            _circle(x(log), 14, _BLUE if log <= 0.0 else "#ffffff"),
        ]
        drawn.append(_row(own.title, parts, 28, own.words))
    if len(rows) > MOST_BARS:
        caption += f" {len(rows) - MOST_BARS} more are in the table."
    return [figure(joined(drawn), caption)]


def value_charts(
    axis: str,
    values: Sequence[float] | Sequence[str],
    figures: Mapping[str, Float[HostArray, " n"]],
) -> list[Html]:
    """Draw figures of trials against their values on an axis, one chart each.

    Args:
        axis: Name of the axis.
        values: Values of the trials, numbers or words; a few get a row each.
        figures: The figures by their names with units; nan is not drawn.
    """
    many = len(set(values)) > MOST_ROWS
    numbers = [float(v) for v in values if not isinstance(v, str)]
    drawn = []
    for name, own in figures.items():
        keep = np.isfinite(own)
        if not keep.any():
            continue
        if many and len(numbers) == len(values):
            chart = _scatter(axis, np.array(numbers)[keep], name, own[keep])
        else:
            chart = _by_value([str(_short(v)) for v in values], own)
            caption = "one dot per trial; the upright line is their mean."
            chart = figure(chart, f"By {axis}: {caption}", title=name)
        drawn.append(chart)
    return drawn


def _short(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"


def _by_value(values: Sequence[str], own: Float[HostArray, " n"]) -> Html:
    """Draw a row of dots for each value, all on one scale."""
    low, high = _span(own[np.isfinite(own)])
    x = lambda number: f"{2.0 + 96.0 * (number - low) / (high - low):.2f}%"
    rows = []
    for value in list(dict.fromkeys(values))[:MOST_BARS]:
        there = np.array(
            [
                number
                for v, number in zip(values, own, strict=True)
                if v == value and math.isfinite(number)
            ]
        )
        parts = [_line("2%", 14, "98%", 14, stroke=_LINE)]
        words = "no number"
        if there.size:
            mean = float(there.mean())
            look = {"stroke": _INK, "stroke_width": "3"}
            parts.append(_line(x(mean), 4, x(mean), 24, **look))
            parts += [_dot(x(number), 14) for number in there]
            words = f"{mean:.5g} in one trial"
            if there.size > 1:
                ends = f"from {there.min():.5g} to {there.max():.5g}"
                words = f"mean {mean:.5g} of {there.size} trials, {ends}"
        rows.append(_row(value, parts, 28, words))
    return joined(rows)


def _scatter(
    axis: str, where: Float[HostArray, " n"], name: str, own: Float[HostArray, " n"]
) -> Html:
    """Draw a dot per trial over its value on an axis."""
    left, right = _span(where)
    ticks = _ticks_between(*_span(own))
    low, high = min(ticks), max(ticks)
    x = lambda value: (
        f"{_LEFT + (_RIGHT - _LEFT) * (value - left) / (right - left):.2f}%"
    )
    y = lambda value: 170.0 - 140.0 * (value - low) / (high - low)
    parts = []
    for value, text in ticks.items():
        parts.append(_line("0", y(value), "100%", y(value), stroke=_LINE))
        parts.append(_text(text, "0", y(value) - 3))
    parts += [_dot(x(at), y(value)) for at, value in zip(where, own, strict=True)]
    for end, anchor in ((left, "start"), (right, "end")):
        parts.append(_text(_short(end), x(end), 190, text_anchor=anchor))
    label = f"{name} of {len(own)} trials over {axis}"
    caption = f"Over {axis}: one dot per trial."
    return figure(_chart(label, 196, parts), caption, title=name)


def _span(values: Float[HostArray, " n"]) -> tuple[float, float]:
    """Return the ends of a scale; equal values get one that is wider than rounding."""
    low, high = float(values.min()), float(values.max())
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        margin = 0.05 * max(abs(low), abs(high)) or 1.0
        return low - margin, high + margin
    return low, high


def course_charts(result: CalibrationResult) -> list[Html]:
    """Draw the fit and the size of the step against the step's index."""
    history = result.history
    if any(fit.points for fit in result.configurations if fit.role == "calibration"):
        fit = _Course(
            "Distance of the markers, root mean square", "mm", lambda e: 1e3 * e.rms
        )
    else:
        fit = _Course("Cost", "no unit", lambda e: e.cost)
    highest = max((fit.of(e) for e in history if math.isfinite(fit.of(e))), default=0.0)
    ticks = _round_ticks(highest)
    size = _Course("Size of the step, largest lambda_p", "no unit", _size)
    tol = result.settings.tol
    sizes = [math.log10(_size(e)) for e in history[1:]]
    low = math.floor(min([*sizes, math.log10(tol)]))
    high = math.ceil(max([*sizes, math.log10(tol)]))
    every = max(1, math.ceil((high - low) / 5))
    decades = {float(k): f"1e{k}" for k in range(low, high + 1, every)}
    at_tol = math.log10(tol), f"tolerance {tol:g}"
    charts = [_course(fit, fit.of, history, ticks)]
    if len(history) > 1:
        log = lambda entry: math.log10(size.of(entry))
        charts.append(_course(size, log, history, decades, marked=at_tol))
    return charts


class _Course(NamedTuple):
    """A number that changes with the steps: title, unit, and its value at each."""

    title: str
    unit: str
    of: Callable[[HistoryEntry], float]


def _size(entry: HistoryEntry) -> float:
    """Size of a step; a step of exactly zero has no logarithm, so rounding instead."""
    return max(*map(abs, entry.lambda_p), 1e-16)


def _course(
    what: _Course,
    height: Callable[[HistoryEntry], float],
    history: Sequence[HistoryEntry],
    ticks: dict[float, str],
    *,
    marked: tuple[float, str] | None = None,
) -> Html:
    """Draw one curve, its grid and, dashed, a level to be reached."""
    last = max(history[-1].step, 1)
    x = lambda step: f"{_LEFT + (_RIGHT - _LEFT) * step / last:.2f}%"
    low, high = min(ticks), max(ticks)
    if marked is not None:
        low, high = min(low, marked[0]), max(high, marked[0])
    y = lambda value: 170.0 - 140.0 * (value - low) / (high - low or 1.0)
    parts = []
    for value, text in ticks.items():
        parts.append(_line("0", y(value), "100%", y(value), stroke=_LINE))
        parts.append(_text(text, "0", y(value) - 3))
    if marked is not None:
        level, text = y(marked[0]), marked[1]
        dashes = {"stroke": _INK, "stroke_dasharray": "6 4", "stroke_width": "1.5"}
        parts.append(_line("0", level, "100%", level, **dashes))
        parts.append(_text(text, "100%", level - 4, text_anchor="end"))
    drawn = [e for e in history if math.isfinite(height(e))]
    for one, two in itertools.pairwise(drawn):
        ends = x(one.step), y(height(one)), x(two.step), y(height(two))
        parts.append(_line(*ends, stroke=_BLUE, stroke_width="2"))
    for entry in drawn:
        at = x(entry.step), y(height(entry))
        parts.append(_circle(*at, _BLUE if entry.accepted else "#ffffff"))
    every = max(1, math.ceil(last / 10))
    for step in range(0, last + 1, every):
        parts.append(_text(str(step), x(step), 190, text_anchor="middle"))
    caption = "Against the number of the step; 0 is the start."
    if not all(entry.accepted for entry in history):
        caption += " Open circles: steps that were refused."
    title = f"{what.title}, {what.unit}"
    return figure(_chart(f"{title}, after each step", 196, parts), caption, title=title)


def _round_ticks(highest: float) -> dict[float, str]:
    """Choose round numbers from zero to beyond the highest value."""
    if not highest > 0.0:
        return {0.0: "0", 1.0: "1"}
    rough = highest / 3.0
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(k * power for k in (1, 2, 5, 10) if k * power >= rough)
    values = step * np.arange(math.ceil(highest / step - 1e-9) + 1)
    return {float(value): f"{value:.6g}" for value in values}


def _ticks_between(low: float, high: float) -> dict[float, str]:
    """Choose round numbers around two ends."""
    power = 10.0 ** math.floor(math.log10((high - low) / 3.0))
    step = next(k * power for k in (1, 2, 5, 10) if k * power >= (high - low) / 3.0)
    first, last = math.floor(low / step), math.ceil(high / step)
    return {k * step: f"{k * step:.6g}" for k in range(first, last + 1)}


def _chart(label: str, height: int, parts: Sequence[Html]) -> Html:
    return node("svg", *parts, role="img", aria_label=label, height=str(height))


def _line(x1: str, y1: float, x2: str, y2: float, **look: str) -> Html:
    return node("line", x1=x1, y1=f"{y1:.1f}", x2=x2, y2=f"{y2:.1f}", **look)


def _circle(x: str, y: float, fill: str) -> Html:
    look = {"fill": fill, "stroke": _BLUE, "stroke_width": "2"}
    return node("circle", cx=x, cy=f"{y:.1f}", r="5", **look)


def _dot(x: str, y: float) -> Html:
    """Draw one of many points, through which others are seen."""
    look = {"fill": _BLUE, "fill_opacity": "0.55", "stroke": _BLUE}
    return node("circle", cx=x, cy=f"{y:.1f}", r="4", **look)


def _text(text: str, x: str, y: float, **look: str) -> Html:
    return node("text", text, x=x, y=f"{y:.1f}", **look)
