"""Plot how far markers moved over time, and the windows that were averaged."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import Recording, Traces
from softcal_jax.plotting._colours import FAINT, SERIES, TEXT
from softcal_jax.plotting._save import DPI, save

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

_WINDOWS = ("#f2c14e", "#7fb7be", "#c9a0dc")
"""Colours of the windows, light enough for the lines above them."""

_MOST_NAMES = 14
"""Most markers that get a legend: two for each colour."""

_AROUND = 1.0
"""What is shown before and after a window, in its lengths [-]."""

_LEAST = 3
"""Least frames that are shown before and after a window."""


def plot_traces(traces: Traces, path: str | Path, *, name: str = "recording") -> None:
    """Plot the motion of the markers of a recording, and each window of it close up.

    Close up are distances from the mean over the window. A line breaks where its marker
    was occluded.

    Args:
        traces: The recording, and what was used of it.
        path: PNG file, 1200 pixels wide, or SVG file.
        name: Name of the configuration.
    """
    save(traces_figure(traces, name), path)


def traces_figure(traces: Traces, name: str) -> "matplotlib.figure.Figure":
    """Build the figure without a screen and without touching Matplotlib's state."""
    from matplotlib.figure import Figure

    recording, windows = traces.recording, _distinct(traces)
    shape = (1 + len(windows), 1)
    figure = Figure((12.0, 1.2 + 3.2 * shape[0]), dpi=DPI, layout="constrained")
    panels = figure.subplots(*shape, squeeze=False)[:, 0]
    _draw(panels[0], traces, _first_seen(recording))
    panels[0].set_ylabel("distance from\nthe first frame [mm]")
    colours = dict(zip(windows, _WINDOWS, strict=False))
    for panel in panels:
        for (start, stop), label in windows.items():
            colour = colours[start, stop]
            # A single frame is drawn as a line.
            panel.axvspan(start, stop, color=colour, lw=2, zorder=0, label=label)
    for panel, (start, stop) in zip(panels[1:], windows, strict=True):
        inside = (recording.times >= start) & (recording.times <= stop)
        part = recording.positions[inside]
        seen = np.isfinite(part)
        n = seen.sum(axis=0)
        mean = np.where(seen, part, 0.0).sum(axis=0) / np.where(n > 0, n, np.nan)
        _draw(panel, traces, mean)
        frame = float(np.median(np.diff(recording.times))) if inside.size > 1 else 1.0
        beside = max(_AROUND * (stop - start), _LEAST * frame)
        panel.set_xlim(start - beside, stop + beside)
        # What is outside may be far away, and is cut.
        off = np.linalg.norm(part - mean, axis=2)[:, _columns(traces)]
        panel.set_ylim(0.0, 3e3 * max(np.nanmax(off, initial=0.0), 1e-6))
        panel.set_ylabel("distance from the\nmean in the window [mm]")
    for panel in panels:
        _finish(panel)
    _legend(panels[0])
    panels[-1].set_xlabel("time [s]", fontsize=14)
    figure.suptitle(
        f"{name}: what was taken of {Path(recording.source).name}",
        fontsize=19,
        weight="bold",
        color=TEXT,
        parse_math=False,
    )
    return figure


def _distinct(traces: Traces) -> dict[tuple[float, float], str]:
    """Return the windows by their times, with all that each is for as its label."""
    found: dict[tuple[float, float], list[str]] = {}
    for what, times in traces.windows.items():
        found.setdefault(times, []).append(what)
    return {times: ", ".join(labels) for times, labels in found.items()}


def _columns(traces: Traces) -> list[int]:
    return [traces.recording.names.index(name) for name in traces.names]


def _first_seen(recording: Recording) -> Float[HostArray, "n_markers 3"]:
    """Return where each marker was seen first; nan if never [m]."""
    seen = np.isfinite(recording.positions).all(axis=2)
    markers = np.arange(len(recording.names))
    return recording.positions[np.argmax(seen, axis=0), markers]


def _draw(
    axes: "matplotlib.axes.Axes", traces: Traces, origin: Float[HostArray, "n 3"]
) -> None:
    away = 1e3 * np.linalg.norm(traces.recording.positions - origin, axis=2)
    named = len(traces.names) <= _MOST_NAMES
    for i, column in enumerate(_columns(traces)):
        axes.plot(
            traces.recording.times,
            away[:, column],
            color=SERIES[i % len(SERIES)],
            ls="-" if i < len(SERIES) else "--",
            lw=1.5,
            label=traces.names[i] if named else None,
        )
    for event, time in traces.recording.events:
        axes.axvline(time, color=FAINT, ls=":", lw=1.5)
        axes.annotate(
            event,
            (time, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(3, -3),
            textcoords="offset points",
            va="top",
            fontsize=11,
            color=FAINT,
            annotation_clip=True,
            parse_math=False,
        )


def _finish(axes: "matplotlib.axes.Axes") -> None:
    axes.grid(True, color="#dddddd", lw=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=13)
    axes.yaxis.label.set_fontsize(14)


def _legend(axes: "matplotlib.axes.Axes") -> None:
    legend = axes.legend(
        fontsize=12, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.04)
    )
    for text in legend.get_texts():
        text.set_parse_math(False)  # a label may hold a dollar sign
