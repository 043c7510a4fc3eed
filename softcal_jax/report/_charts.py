"""Charts of a page; what colours tell apart, shapes or words tell too.

They are SVG whose text keeps its size, however wide the page is: places along the width
are percentages, and those along the height pixels.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    ParameterEstimate,
)
from softcal_jax.inference import ErrorBudget
from softcal_jax.report._calibration import distance
from softcal_jax.report._html import Html, figure, joined, node

INK, BLUE, LINE, PAPER = "#1a1a1a", "#0b4f8a", "#c8c8c8", "#ffffff"

MOST_BARS = 24
"""Most rows of a chart."""

LEAST_NAMED = 0.01
"""Share of a variance from which on a cause is named beside the bar [-]."""

# Darker and lighter in turn, so that neighbours differ in grey as well.
_FILLS = ("#8c8c8c", "#0b4f8a", "#f0b27a", "#1b7a5a", "#d9cdf0", "#5b4310", "#ffffff")
"""Colours of the causes, from the first again where they are used up."""


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
    x = lambda value: f"{2.0 + 96.0 * value / longest:.2f}%"
    parts = [line("2%", 14, "98%", 14, stroke=LINE)]
    before, after = "no equilibrium before", x(fit.rms_after)
    if math.isfinite(fit.motion):
        moved = x(fit.motion)
        parts.append(line(moved, 3, moved, 25, stroke=INK, stroke_width="3"))
    if math.isfinite(fit.rms_before):
        start = x(fit.rms_before)
        parts.append(line(after, 14, start, 14, stroke=BLUE, stroke_width="3"))
        parts.append(circle(start, 14, filled=False))
        before = f"{distance(fit.rms_before)} before"
    parts.append(circle(after, 14))
    held = " (held out)" if fit.role == "validation" else ""
    words = f"{before}, {distance(fit.rms_after)} after, moved {distance(fit.motion)}"
    return row(f"{fit.name}{held}", parts, words)


def budget_chart(result: CalibrationResult) -> list[Html]:
    """Draw the share of each cause in the variance of each parameter."""
    shares = _budget_shares(result.budget)
    known = [
        (i, q)
        for i, q in enumerate(result.parameters)
        if sum(share[i] for share in shares.values()) > 0.0
    ]
    if not known:
        return []
    bars = [
        _bar(parameter, {cause: float(share[i]) for cause, share in shares.items()})
        for i, parameter in known[:MOST_BARS]
    ]
    # Colours repeat, so what is too thin to be seen is left out.
    named = [max(share) >= LEAST_NAMED for share in shares.values()]
    entries = [_entry(k, cause) for k, cause in enumerate(shares) if named[k]]
    legend = node("ul", *entries, class_="legend")
    caption = (
        "Where the standard error of each parameter comes from: share of each cause in "
        "its square. The longest part is what to measure better first."
    )
    if len(known) > MOST_BARS:
        caption += f" {len(known) - MOST_BARS} more parameters are in the table."
    return [figure(joined([legend, *bars]), caption)]


def _budget_shares(budget: ErrorBudget) -> dict[str, Float[HostArray, " n_p"]]:
    """Compute the share of each cause in the variance of each parameter [-].

    That of the noise is first; all are zero without a standard error.
    """
    squares = {cause: std**2 for cause, std in budget.by_cause().items()}
    total = sum(squares.values())
    known = np.isfinite(total) & (total > 0.0)
    return {
        cause: np.where(known, square, 0.0) / np.where(known, total, 1.0)
        for cause, square in squares.items()
    }


def _bar(parameter: ParameterEstimate, shares: Mapping[str, float]) -> Html:
    parts, left = [], 0.0
    for k, share in enumerate(shares.values()):
        place = {"x": f"{100.0 * left:.3f}%", "width": f"{100.0 * share:.3f}%"}
        parts.append(_filled(k, y="1", height="22", **place))
        left += share
    ranked = sorted(shares.items(), key=lambda item: -item[1])
    named = (f"{c} {100 * s:.0f} %" for c, s in ranked if s >= LEAST_NAMED)
    title = f"{parameter.name} = {parameter}"
    return row(title, parts, ", ".join(named), height=24)


def _entry(k: int, cause: str) -> Html:
    swatch = _filled(k, x="0", y="0", width="28", height="16")
    return node("li", node("svg", swatch, height="16", aria_hidden="true"), cause)


def _filled(k: int, **place: str) -> Html:
    return node("rect", **place, fill=_FILLS[k % len(_FILLS)], stroke=INK)


def row(title: str, parts: Sequence[Html], words: str, *, height: int = 28) -> Html:
    """Put a chart of one row between its title and the same in words."""
    drawn = node("svg", *parts, height=str(height), aria_hidden="true")
    head = node("p", node("strong", title))
    return node("div", head, drawn, node("p", words), class_="row")


def line(x1: str, y1: float, x2: str, y2: float, **look: str) -> Html:
    """Draw a straight line."""
    return node("line", x1=x1, y1=f"{y1:.1f}", x2=x2, y2=f"{y2:.1f}", **look)


def circle(x: str, y: float, *, filled: bool = True) -> Html:
    """Draw a circle, filled or open."""
    look = {"fill": BLUE if filled else PAPER, "stroke": BLUE, "stroke_width": "2"}
    return node("circle", cx=x, cy=f"{y:.1f}", r="5", **look)


def text(words: str, x: str, y: float, **look: str) -> Html:
    """Write words at a place."""
    return node("text", words, x=x, y=f"{y:.1f}", **look)
