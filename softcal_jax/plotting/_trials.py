"""Plot trials against the axes of a sweep."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal_jax._text import escaped
from softcal_jax._typing import Float, HostArray
from softcal_jax.plotting._colours import BAD, SERIES, TEXT
from softcal_jax.plotting._save import DPI, save

if TYPE_CHECKING:
    import matplotlib.axes

_MOST_LABELS = 12
"""Most groups on an axis whose labels stay horizontal."""


def plot_trials(
    columns: Mapping[str, Sequence[float] | Sequence[str]],
    figures: Mapping[str, Float[HostArray, " n"]],
    path: str | Path,
    *,
    title: str = "",
    left_out: str = "",
) -> None:
    """Plot every figure of some trials against every axis, which is a column.

    Numbers make a scatter; words make groups, each with a bar at its mean. A nan is not
    drawn. Below the title stands which trials are left out, and why.

    Raises:
        ValueError: If there is nothing to draw.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    if not any(np.isfinite(values).any() for values in figures.values()):
        raise ValueError("there is nothing to draw: no trial has converged yet.")
    n_rows, n_columns = shape = len(figures), len(columns)
    size = (max(8.0, 2.0 + 5.0 * n_columns), 1.2 + 3.0 * n_rows)
    drawing = Figure(figsize=size, dpi=DPI, layout="constrained")
    panels = drawing.subplots(*shape, sharex="col", sharey="row", squeeze=False)
    for row, (label, values) in zip(panels, figures.items(), strict=True):
        for axes, where in zip(row, columns.values(), strict=True):
            _draw(axes, where, values)
        row[0].set_ylabel(escaped(label), fontsize=14, parse_math=False)
    for axes, name in zip(panels[-1], columns, strict=True):
        axes.set_xlabel(escaped(name), fontsize=14, parse_math=False)
    if title:
        style = {"fontsize": 18, "weight": "bold", "color": TEXT}
        drawing.suptitle(title, **style, parse_math=False)
    if left_out:
        style = {"fontsize": 13, "color": BAD, "loc": "left"}
        panels[0, 0].set_title(left_out, **style, parse_math=False)
    if any(isinstance(where[0], str) for where in columns.values()):
        bar = Line2D([], [], color=SERIES[1], lw=2.5, label="mean")
        drawing.legend(handles=[bar], loc="upper right", fontsize=13, frameon=False)
    drawing.get_layout_engine().set(h_pad=0.1, w_pad=0.1)  # pyright: ignore
    save(drawing, path)


def _draw(axes: "matplotlib.axes.Axes", where: Sequence[Any], values: Any) -> None:
    axes.grid(True, color="#dddddd", lw=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=12)
    dots = {"ls": "none", "marker": "o", "color": SERIES[0], "alpha": 0.55, "ms": 7}
    if not any(isinstance(value, str) for value in where):
        axes.plot(np.asarray(where, float), values, **dots)
        axes.margins(0.06)
        own = sorted(set(where))
        if len(own) <= _MOST_LABELS:
            axes.set_xticks(own, [f"{value:g}" for value in own])
        return
    groups = list(dict.fromkeys(where))
    labels = [escaped(group) for group in groups]
    for i, group in enumerate(groups):
        own = np.array([v for v, w in zip(values, where, strict=True) if w == group])
        own = own[np.isfinite(own)]
        if not own.size:
            continue
        # Spread sideways in order, so that equal values do not hide each other.
        width = 0.0 if own.size == 1 else 0.25
        axes.plot(i + width * np.linspace(-1.0, 1.0, own.size), own, **dots)
        axes.plot([i - 0.35, i + 0.35], [own.mean()] * 2, color=SERIES[1], lw=2.5)
    turn = 90 if len(groups) > _MOST_LABELS else 0
    axes.set_xticks(range(len(groups)), labels, rotation=turn, parse_math=False)
    axes.set_xlim(-0.6, len(groups) - 0.4)
