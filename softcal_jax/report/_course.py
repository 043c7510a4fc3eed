"""Charts of the course of a fit: what changes from step to step."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from softcal_jax._units import readable_unit
from softcal_jax.calibration import CalibrationResult, HistoryEntry, ParameterEstimate
from softcal_jax.identifiability import end_of
from softcal_jax.report._charts import BLUE, INK, LINE, circle, line, text
from softcal_jax.report._html import Html, figure, node

MOST_PARAMETERS = 7
"""Most parameters whose course is drawn."""

_TOP, _BOTTOM, _LABELS, _HEIGHT = 30.0, 170.0, 190.0, 196
"""Where a chart over an axis begins and ends, its labels stand, and its height."""


class _Curve(NamedTuple):
    """A number that changes with the steps: its value `at` one, with the title's unit.

    `ticks` are the grid; `level` is a value to be reached, and its name.
    """

    title: str
    at: Callable[[HistoryEntry], float]
    ticks: Mapping[float, str]
    level: tuple[float, str] | None = None
    caption: str = ""


def course_charts(result: CalibrationResult) -> list[Html]:
    """Draw the fit, the size of the step and the parameters against the steps."""
    curves = [_fit(result)]
    if len(result.history) > 1:
        curves.append(_step_size(result))
    curves += [_parameter(result, q) for q in result.parameters[:MOST_PARAMETERS]]
    charts = node("div", *(_drawn(curve, result) for curve in curves), class_="charts")
    words = "Each against the number of the step; 0 is the start."
    if not all(entry.accepted for entry in result.history):
        words += " Open circles: steps that were refused."
    if _noise_changes(result):
        words += " Dotted line: there the noise was estimated anew."
    return [node("p", words), charts]


def _fit(result: CalibrationResult) -> _Curve:
    fitted = [fit for fit in result.configurations if fit.role == "calibration"]
    title = "Distance of the markers, root mean square [mm]"
    at = lambda entry: 1e3 * entry.rms
    if not any(fit.points for fit in fitted):  # lengths, angles or forces alone
        title, at = "Cost [-]", lambda entry: entry.cost
    values = [v for v in map(at, result.history) if math.isfinite(v)]
    return _Curve(title, at, round_ticks([0.0, *values]))


def _step_size(result: CalibrationResult) -> _Curve:
    """Draw the largest lambda_p over the tolerance, on a logarithmic scale."""
    # A step of exactly zero has no logarithm; it is drawn at the level of rounding.
    at = lambda entry: math.log10(max(*map(abs, entry.lambda_p), 1e-16))
    tol = result.settings.tol
    level = math.log10(tol)
    sizes = [*map(at, result.history[1:]), level]
    low, high = math.floor(min(sizes)), math.ceil(max(sizes))
    every = max(1, math.ceil((high - low) / 5))
    ticks = {float(k): f"1e{k}" for k in range(low, high + 1, every)}
    title, named = "Size of the step, largest lambda_p [-]", f"tolerance {tol:g}"
    return _Curve(title, at, ticks, (level, named), end_of(result))


def _parameter(result: CalibrationResult, q: ParameterEstimate) -> _Curve:
    series = [entry.values[q.name] for entry in result.history]
    factor, unit = readable_unit(series, q.unit)
    at = lambda entry: factor * entry.values[q.name]
    ticks = round_ticks([factor * value for value in series])
    bounds = f"{factor * q.lower:.4g} to {factor * q.upper:.4g} {unit}".rstrip()
    bound = ", on a bound" if q.at_bound else ""
    words = f"Ends at {q}{bound}; bounds {bounds}."
    return _Curve(f"{q.name} [{unit or '-'}]", at, ticks, caption=words)


def _drawn(curve: _Curve, result: CalibrationResult) -> Html:
    """Draw one curve over the steps."""
    history = result.history
    last = max(history[-1].step, 1)
    level = {} if curve.level is None else dict([curve.level])
    low, high = min([*curve.ticks, *level]), max([*curve.ticks, *level])
    x = lambda step: f"{14.0 + 82.0 * step / last:.2f}%"
    y = lambda v: _BOTTOM - (_BOTTOM - _TOP) * (v - low) / (high - low or 1.0)
    parts = []
    for value, label in curve.ticks.items():
        parts.append(line("0", y(value), "100%", y(value), stroke=LINE))
        parts.append(text(label, "0", y(value) - 3))
    for value, label in level.items():
        look = {"stroke": INK, "stroke_dasharray": "6 4", "stroke_width": "1.5"}
        parts.append(line("0", y(value), "100%", y(value), **look))
        # On the left: there a curve that falls to the level is still far from it.
        parts.append(text(label, "12%", y(value) - 4))
    for step in _noise_changes(result):
        look = {"stroke": INK, "stroke_dasharray": "2 4"}
        parts.append(line(x(step), _TOP, x(step), _BOTTOM, **look))
    known = [entry for entry in history if math.isfinite(curve.at(entry))]
    places = [(x(entry.step), y(curve.at(entry))) for entry in known]
    for start, end in itertools.pairwise(places):
        parts.append(line(*start, *end, stroke=BLUE, stroke_width="2"))
    for entry, place in zip(known, places, strict=True):
        parts.append(circle(*place, filled=entry.accepted))
    for step in range(0, last + 1, max(1, math.ceil(last / 10))):
        parts.append(text(str(step), x(step), _LABELS, text_anchor="middle"))
    words = f"{curve.title}, after each step"
    drawn = node("svg", *parts, role="img", aria_label=words, height=str(_HEIGHT))
    return figure(drawn, curve.caption, title=curve.title)


def _noise_changes(result: CalibrationResult) -> list[float]:
    """Return where the data are weighed anew, between steps: the fit goes on there."""
    return [
        0.5 * (before.step + entry.step)
        for before, entry in itertools.pairwise(result.history)
        if not math.isclose(before.noise_level, entry.noise_level)
    ]


def round_ticks(values: Sequence[float]) -> dict[float, str]:
    """Choose round numbers around values, for about three lines of a grid."""
    from matplotlib.ticker import MaxNLocator

    low, high = min(values), max(values)
    if high - low <= 1e-9 * max(abs(low), abs(high)):  # equal up to rounding
        margin = 0.05 * max(abs(low), abs(high)) or 1.0
        low, high = low - margin, high + margin
    ticks = MaxNLocator(3, steps=[1, 2, 5, 10]).tick_values(low, high)
    return {float(tick): f"{tick:.6g}" for tick in ticks}
