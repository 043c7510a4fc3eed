"""Charts of the trials of a sweep against the values of an axis."""

from collections.abc import Mapping, Sequence

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.report._charts import MOST_BARS
from softcal_jax.report._html import Html, figure, joined
from softcal_jax.report._svg import (
    Axes,
    dot,
    round_ticks,
    row,
    row_line,
    row_scale,
    span,
    upright,
)

MOST_ROWS = 8
"""Most values of an axis that get a row each where they are numbers."""


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
    for name, results in figures.items():
        keep = np.isfinite(results)
        if not keep.any():
            continue
        if many and len(numbers) == len(values):
            chart = _scatter(axis, np.array(numbers)[keep], name, results[keep])
        else:
            chart = _by_value([_short(v) for v in values], results)
            caption = "one dot per trial; the upright line is their mean."
            chart = figure(chart, f"By {axis}: {caption}", title=name)
        drawn.append(chart)
    return drawn


def _short(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"


def _by_value(values: Sequence[str], results: Float[HostArray, " n"]) -> Html:
    """Draw a row of dots for each value, all on one scale."""
    x = row_scale(*span(results[np.isfinite(results)]))
    rows = []
    for value in list(dict.fromkeys(values))[:MOST_BARS]:
        of_value = results[[v == value for v in values]]
        numbers = of_value[np.isfinite(of_value)]
        parts, words = [row_line()], "no number"
        if numbers.size:
            mean = float(numbers.mean())
            parts += [upright(x(mean)), *(dot(x(number), 14) for number in numbers)]
            words = f"{mean:.5g} in one trial"
            if numbers.size > 1:
                ends = f"from {numbers.min():.5g} to {numbers.max():.5g}"
                words = f"mean {mean:.5g} of {numbers.size} trials, {ends}"
        rows.append(row(value, parts, words))
    return joined(rows)


def _scatter(
    axis: str,
    values: Float[HostArray, " n"],
    name: str,
    results: Float[HostArray, " n"],
) -> Html:
    """Draw a dot per trial over its value on an axis."""
    ends = span(values)
    axes = Axes(ends, round_ticks(*span(results)))
    axes.add(*(dot(axes.x(v), axes.y(r)) for v, r in zip(values, results, strict=True)))
    for end, anchor in zip(ends, ("start", "end"), strict=True):
        axes.label(end, _short(end), anchor)
    label = f"{name} of {len(results)} trials over {axis}"
    return axes.figure(name, label, f"Over {axis}: one dot per trial.")
