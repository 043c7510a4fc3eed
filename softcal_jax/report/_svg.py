"""Parts of charts as SVG whose text keeps its size, however wide the page is.

Places along the width are percentages, and those along the height pixels.
"""

import math
from collections.abc import Callable, Mapping, Sequence

from softcal_jax._typing import Float, HostArray
from softcal_jax.report._html import Html, figure, node

INK, BLUE, LINE, PAPER = "#1a1a1a", "#0b4f8a", "#c8c8c8", "#ffffff"

_TOP, _BOTTOM, _LABELS, _HEIGHT = 30.0, 170.0, 190.0, 196
"""Where a chart over an axis begins and ends, its labels stand, and its height."""


def row(title: str, parts: Sequence[Html], words: str, *, height: int = 28) -> Html:
    """Put a chart of one row between its title and the same in words."""
    return node(
        "div",
        node("p", node("strong", title)),
        node("svg", *parts, height=str(height), aria_hidden="true"),
        node("p", words),
        class_="row",
    )


def row_scale(low: float, high: float) -> Callable[[float], str]:
    """Return what places a value in a row from its lowest and its highest."""
    return lambda value: f"{2.0 + 96.0 * (value - low) / (high - low):.2f}%"


def row_line() -> Html:
    """Draw the line on which the values of a row stand."""
    return line("2%", 14, "98%", 14, stroke=LINE)


def upright(x: str) -> Html:
    """Draw an upright mark across a row."""
    return line(x, 3, x, 25, stroke=INK, stroke_width="3")


class Axes:
    """A chart of values over an axis, drawn part by part."""

    def __init__(
        self,
        across: tuple[float, float],
        ticks: Mapping[float, str],
        *,
        level: tuple[float, str] | None = None,
    ):
        """Draw the grid.

        Args:
            across: Ends of the axis.
            ticks: Texts beside lines of the grid, by their values.
            level: A value that is marked by a dashed line, and its text.
        """
        self._left, self._right = across
        heights = [*ticks, *([] if level is None else level[:1])]
        self._low, self._high = min(heights), max(heights)
        self._parts: list[Html] = []
        for value, label in ticks.items():
            y = self.y(value)
            self._parts.append(line("0", y, "100%", y, stroke=LINE))
            self._parts.append(text(label, "0", y - 3))
        if level is not None:
            y = self.y(level[0])
            look = {"stroke": INK, "stroke_dasharray": "6 4", "stroke_width": "1.5"}
            self._parts.append(line("0", y, "100%", y, **look))
            # On the left: there a curve that falls to the level is still far from it.
            self._parts.append(text(level[1], "12%", y - 4))

    def x(self, value: float) -> str:
        """Place a value along the axis."""
        return f"{14.0 + 82.0 * (value - self._left) / (self._right - self._left):.2f}%"

    def y(self, value: float) -> float:
        """Place a value along the height [pixels]."""
        share = (value - self._low) / (self._high - self._low or 1.0)
        return _BOTTOM - (_BOTTOM - _TOP) * share

    def add(self, *parts: Html) -> None:
        """Draw parts that were placed by `x` and `y`."""
        self._parts += parts

    def label(self, value: float, words: str, anchor: str = "middle") -> None:
        """Write a value below the axis."""
        self.add(text(words, self.x(value), _LABELS, text_anchor=anchor))

    def mark(self, value: float) -> None:
        """Draw a dotted upright line across the chart."""
        x = self.x(value)
        self.add(line(x, _TOP, x, _BOTTOM, stroke=INK, stroke_dasharray="2 4"))

    def figure(self, title: str, label: str, caption: str) -> Html:
        """Finish the chart: `label` says what it shows to who cannot see it."""
        drawn = node(
            "svg", *self._parts, role="img", aria_label=label, height=str(_HEIGHT)
        )
        return figure(drawn, caption, title=title)


def round_ticks(low: float, high: float) -> dict[float, str]:
    """Choose round numbers around two ends, for about three lines of a grid."""
    if not high > low:
        return {low: f"{low:.6g}", low + 1.0: f"{low + 1.0:.6g}"}
    power = 10.0 ** math.floor(math.log10((high - low) / 3.0))
    step = next(k * power for k in (1, 2, 5, 10) if k * power >= (high - low) / 3.0)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return {k * step: f"{k * step:.6g}" for k in range(first, last + 1)}


def span(values: Float[HostArray, " n"]) -> tuple[float, float]:
    """Return the ends of a scale; equal values get one that is wider than rounding."""
    low, high = float(values.min()), float(values.max())
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        margin = 0.05 * max(abs(low), abs(high)) or 1.0
        return low - margin, high + margin
    return low, high


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
