"""Diagrams: markers of a recording over time, and trials against axes of a sweep."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax._text import escaped
from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import Traces
from softcal_jax.plotting._figure import BAD, DPI, FAINT, SERIES, TEXT, Axes, save

_WINDOWS = ("#f2c14e", "#7fb7be", "#c9a0dc")  # light enough for lines above them
_MOST_NAMES = 14  # markers that get a legend: two for each colour
_AROUND, _LEAST = 1.0, 3  # time beside a window: in its lengths, at least in frames
_MOST_LABELS = 12  # groups on an axis whose labels stay horizontal


def plot_traces(traces: Traces, path: str | Path, *, name: str = "recording") -> None:
    """Plot the motion of the markers of a recording, and each window of it close up.

    Close-ups show distances from the mean over the window. A line breaks where its
    marker was occluded. `name` is that of the configuration.
    """
    from matplotlib.figure import Figure

    recording = traces.recording
    # All that a window is used for is its label.
    windows: dict[tuple[float, float], str] = {}
    for what, times in traces.windows.items():
        windows[times] = f"{windows[times]}, {what}" if times in windows else what
    shape = (1 + len(windows), 1)
    figure = Figure((12.0, 1.2 + 3.2 * shape[0]), dpi=DPI, layout="constrained")
    panels = figure.subplots(*shape, squeeze=False)[:, 0]
    seen = np.isfinite(recording.positions).all(axis=2)
    markers = np.arange(len(recording.names))
    first = recording.positions[np.argmax(seen, axis=0), markers]
    _draw_distances(panels[0], traces, first)
    panels[0].set_ylabel("distance from\nthe first frame [mm]", fontsize=14)
    for k, ((start, stop), label) in enumerate(windows.items()):
        for panel in panels:
            colour = _WINDOWS[k % len(_WINDOWS)]
            # A single frame is drawn as a line.
            panel.axvspan(start, stop, color=colour, lw=2, zorder=0, label=label)
    for panel, (start, stop) in zip(panels[1:], windows, strict=True):
        inside = (recording.times >= start) & (recording.times <= stop)
        part = recording.positions[inside]
        mean = np.ma.masked_invalid(part).mean(axis=0).filled(np.nan)
        columns = _draw_distances(panel, traces, mean)
        frame = float(np.median(np.diff(recording.times))) if inside.size > 1 else 1.0
        beside = max(_AROUND * (stop - start), _LEAST * frame)
        panel.set_xlim(start - beside, stop + beside)
        # Positions outside the window may be far away, and are cut off.
        off = np.linalg.norm(part - mean, axis=2)[:, columns]
        panel.set_ylim(0.0, 3e3 * max(np.nanmax(off, initial=0.0), 1e-6))
        panel.set_ylabel("distance from the\nmean in the window [mm]", fontsize=14)
    place = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.04)}
    for text in panels[0].legend(fontsize=12, frameon=False, **place).get_texts():
        text.set_parse_math(False)  # a label may hold a dollar sign
    panels[-1].set_xlabel("time [s]", fontsize=14)
    title = f"{name}: windows taken from {Path(recording.source).name}"
    style = {"fontsize": 19, "weight": "bold", "color": TEXT, "parse_math": False}
    figure.suptitle(title, **style)
    save(figure, path)


def _draw_distances(
    axes: Axes, traces: Traces, origin: Float[HostArray, "n 3"]
) -> list[int]:
    """Draw the distance of each marker from an origin; return the markers' columns."""
    recording, names = traces.recording, traces.names
    columns = [recording.names.index(name) for name in names]
    away = 1e3 * np.linalg.norm(recording.positions - origin, axis=2)
    for i, column in enumerate(columns):
        axes.plot(
            recording.times,
            away[:, column],
            color=SERIES[i % len(SERIES)],
            ls="-" if i < len(SERIES) else "--",
            lw=1.5,
            label=names[i] if len(names) <= _MOST_NAMES else None,
        )
    look = {"fontsize": 11, "color": FAINT, "va": "top", "parse_math": False}
    where = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
    for event, time in recording.events:
        axes.axvline(time, color=FAINT, ls=":", lw=1.5)
        place = {**where, "xytext": (3, -3), "annotation_clip": True}
        axes.annotate(event, (time, 1.0), **place, **look)
    _draw_grid(axes, 13)
    return columns


def plot_trials(
    columns: Mapping[str, Sequence[float] | Sequence[str]],
    figures: Mapping[str, Float[HostArray, " n"]],
    path: str | Path,
    *,
    title: str = "",
    left_out: str = "",
) -> None:
    """Plot every figure of some trials against every axis, given as a column.

    Numbers make a scatter; words make groups, each with a bar at its mean. A nan is not
    drawn. `left_out` says below the title which trials are left out, and why.

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
            _draw_trials(axes, where, values)
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


def _draw_trials(
    axes: Axes, where: Sequence[Any], values: Float[HostArray, " n"]
) -> None:
    _draw_grid(axes, 12)
    dots = {"ls": "none", "marker": "o", "color": SERIES[0], "alpha": 0.55, "ms": 7}
    if not any(isinstance(value, str) for value in where):
        axes.plot(np.asarray(where, float), values, **dots)
        axes.margins(0.06)
        ticks = sorted(set(where))
        if len(ticks) <= _MOST_LABELS:
            axes.set_xticks(ticks, [f"{value:g}" for value in ticks])
        return
    groups = list(dict.fromkeys(where))
    labels = [escaped(group) for group in groups]
    for i, group in enumerate(groups):
        sample = np.array([v for v, w in zip(values, where, strict=True) if w == group])
        sample = sample[np.isfinite(sample)]
        if not sample.size:
            continue
        # Spread sideways in order, so that equal values do not hide each other.
        width = 0.0 if sample.size == 1 else 0.25
        axes.plot(i + width * np.linspace(-1.0, 1.0, sample.size), sample, **dots)
        axes.plot([i - 0.35, i + 0.35], [sample.mean()] * 2, color=SERIES[1], lw=2.5)
    turn = 90 if len(groups) > _MOST_LABELS else 0
    axes.set_xticks(range(len(groups)), labels, rotation=turn, parse_math=False)
    axes.set_xlim(-0.6, len(groups) - 0.4)


def _draw_grid(axes: Axes, size: float) -> None:
    axes.grid(True, color="#dddddd", lw=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=size)
