"""Charts: a calibration and its errors, a recording over time, trials of a sweep."""

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax._text import escaped
from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax._units import is_number, readable_unit
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.plotting import _figure as figures
from softcal_jax.plotting._figure import FAINT, SERIES, TEXT, Axes, PictureStyle
from softcal_jax.readings import Traces

LEAST_NAMED = 0.01  # share of a variance of which the cause is named [-]

# Darker and lighter in turn, so that neighbours differ in grey as well. Where there are
# more causes, the colours repeat.
_FILLS = ("#8c8c8c", "#0b4f8a", "#f0b27a", "#1b7a5a", "#d9cdf0", "#5b4310", "#ffffff")
_OPEN: dict[str, Any] = {
    "ls": "none",
    "marker": "o",
    "color": SERIES[0],
    "mfc": "white",
}
_LEAST = 1e-16  # a step of exactly zero has no logarithm


def draw_errors(axes: Axes, fits: Sequence[ConfigurationResult]) -> Axes:
    """Draw the errors of configurations before and after the fit, beside the motion.

    Each is the root mean square distance of the simulated markers from the measured
    ones. A configuration without one is left out.
    """
    shown = [fit for fit in fits if math.isfinite(fit.rms_after)]
    sizes = [(fit.rms_before, fit.rms_after, fit.motion) for fit in shown]
    factor, unit = readable_unit(itertools.chain(*sizes), "m")
    before, after, motion = factor * np.array(sizes).reshape(-1, 3).T
    rows = np.arange(len(shown))
    axes.hlines(rows, before, after, color=SERIES[0])
    axes.vlines(motion, rows - 0.3, rows + 0.3, color=TEXT, label="motion")
    axes.plot(before, rows, **_OPEN, clip_on=False, label="before the fit")
    axes.plot(after, rows, "o", color=SERIES[0], clip_on=False, label="after it")
    held = {"validation": " (held out)"}
    _name_rows(axes, [f.name + held.get(f.role, "") for f in shown])
    axes.set_xlim(left=0.0)
    axes.set_xlabel(f"rms distance [{unit}]")
    return figures.draw_grid(axes)


def draw_workspace(axes: Axes, fits: Sequence[ConfigurationResult]) -> Axes:
    """Draw the errors after calibration at the places where the markers are.

    Each configuration is at the mean place of its simulated points, in the plane in
    which these means differ most; the area of its circle is the error. Filled circles
    were held out.
    """
    shown = [fit for fit in fits if math.isfinite(fit.rms_after)]
    places = np.array([np.mean([e.simulated for e in f.points], axis=0) for f in shown])
    factor, unit = readable_unit(places.flat, "m")
    plane = np.sort(np.argsort(-np.ptp(places, axis=0), kind="stable")[:2])
    errors = np.array([fit.rms_after for fit in shown])
    faces = [SERIES[0] if fit.role == "validation" else "white" for fit in shown]
    look: dict[str, Any] = {"facecolors": faces, "edgecolors": SERIES[0], "alpha": 0.6}
    x, y = factor * places[:, plane].T
    axes.scatter(x, y, 150.0 * errors / (errors.max() or 1.0), **look)
    axes.margins(0.15)
    across, up = ("xyz"[k] for k in plane)
    axes.set(xlabel=f"{across} [{unit}]", ylabel=f"{up} [{unit}]")
    return figures.draw_grid(axes)


def draw_budget(axes: Axes, result: CalibrationResult, *, most: int = 24) -> Axes:
    """Draw the share of each cause in the variance of the first `most` parameters.

    A parameter without a standard error is left out, and in the legend a cause that is
    too thin to be seen.
    """
    squares = {cause: std**2 for cause, std in result.budget.by_cause().items()}
    total = np.asarray(sum(squares.values()))
    known = np.flatnonzero(np.isfinite(total) & (total > 0.0))[:most]
    left, rows = np.zeros(len(known)), np.arange(len(known))
    for k, (cause, square) in enumerate(squares.items()):
        share = 100.0 * square[known] / total[known]
        label = escaped(cause) if np.any(share >= 100.0 * LEAST_NAMED) else ""
        look = {"color": _FILLS[k % len(_FILLS)], "ec": TEXT, "lw": 0.5}
        axes.barh(rows, share, 0.7, left=left, **look, label=label)
        left += share
    _name_rows(axes, [result.parameters[i].name for i in known])
    axes.set(xlim=(0.0, 100.0), xlabel="share of the variance [%]")
    return axes


def _name_rows(axes: Axes, names: Sequence[str]) -> None:
    """Name rows from above, which stand at 0, 1, ..."""
    axes.set_yticks(range(len(names)), list(map(escaped, names)), parse_math=False)
    axes.set_ylim(len(names) - 0.4, -0.6)


def draw_course(
    axes: Axes, result: CalibrationResult, name: str, *, truth: float | None = None
) -> Axes:
    """Draw what a calibration came to, step by step.

    Args:
        axes: Where to draw.
        result: The calibration.
        name: A parameter; or "rms", the residual of the markers, "cost", or "lambda_p",
            the largest step, with the tolerance.
        truth: True value of the parameter, in SI, as a dashed line.

    Returns:
        The axes; a last value that stands on a bound is an open square.
    """
    q = next((q for q in result.parameters if q.name == name), None)
    history, label, unit = result.history, name, "-" if q is None else q.unit
    if q is not None:
        values = [entry.values[name] for entry in history]
    elif name == "lambda_p":
        label = "step size"
        values = [max(*map(abs, entry.lambda_p), _LEAST) for entry in history]
        axes.set_yscale("log")
        tol = result.settings.tol
        axes.axhline(tol, color=TEXT, ls="--", label=f"tolerance {tol:g}")
    else:
        values = [getattr(entry, name) for entry in history]
        label, unit = ("rms residual", "m") if name == "rms" else (name, "-")
    factor, shown = readable_unit(values, unit)
    steps = np.array([entry.step for entry in history])
    values = factor * np.array(values)
    taken = np.array([entry.accepted for entry in history])
    axes.plot(steps, values, color=SERIES[0])
    axes.plot(steps[taken], values[taken], "o", color=SERIES[0])
    if not taken.all():
        axes.plot(steps[~taken], values[~taken], **_OPEN, label="step refused")
    for before, entry in itertools.pairwise(history):
        if not math.isclose(before.noise_level, entry.noise_level):
            middle = 0.5 * (before.step + entry.step)
            axes.axvline(middle, color=TEXT, ls=":", label="noise estimated anew")
    if q is None and name != "lambda_p":
        axes.set_ylim(bottom=0.0)
    if truth is not None:
        axes.axhline(factor * truth, color=TEXT, ls="--", label="true value")
    if q is not None and q.at_bound:
        draw_on_bound(axes, steps[-1:], values[-1:])
    axes.set_xlabel("step")
    axes.set_ylabel(f"{escaped(label)} [{shown or '-'}]", parse_math=False)
    axes.xaxis.get_major_locator().set_params(integer=True)  # pyright: ignore
    return figures.draw_grid(axes)


def draw_on_bound(axes: Axes, x, y) -> None:
    """Mark values that stand on a bound, by open squares."""
    squares: dict[str, Any] = {"ls": "none", "marker": "s", "mfc": "white", "zorder": 3}
    axes.plot(x, y, **squares, mec=figures.BAD, label="on a bound")


_WINDOWS = ("#f2c14e", "#7fb7be", "#c9a0dc")  # light enough for lines above them
_MOST_NAMES = 14  # markers that get a legend: two for each colour
_AROUND, _SHORTEST = 1.0, 3  # time beside a window: in its lengths, at least in frames
_LINE = 1.4 * figures.INCH / 72.0  # height of a line, over its words [mm/pt]
_MOST_TICKS = 12  # values on an axis, each with its label


def plot_traces(
    traces: Traces,
    path: str | Path,
    *,
    name: str = "recording",
    style: PictureStyle = figures.SCREEN,
) -> None:
    """Plot the motion of the markers of a recording, and each window of it close up.

    The file is PNG, SVG or PDF; `name` is that of the configuration.
    """
    windows = None, *dict.fromkeys(traces.windows.values())
    drawn = [partial(draw_traces, traces=traces, window=window) for window in windows]
    title = f"{name}: windows taken from {Path(traces.recording.source).name}"
    plot_panels(path, drawn, style=style, title=title)


def draw_traces(
    axes: Axes, traces: Traces, *, window: tuple[float, float] | None = None
) -> Axes:
    """Draw the distance of each marker of a recording from its first place over time.

    A line breaks where its marker was occluded. Windows are coloured, events are dotted
    lines. With a `window` [s], its surroundings are drawn close up, as distances from
    the mean over it.
    """
    recording = traces.recording
    named: dict[tuple[float, float], str] = {}
    for what, times in traces.windows.items():
        named[times] = f"{named[times]}, {what}" if times in named else what
    for k, ((start, stop), label) in enumerate(named.items()):
        colour = _WINDOWS[k % len(_WINDOWS)]
        # A single frame is drawn as a line.
        axes.axvspan(start, stop, color=colour, zorder=0, label=label)
    columns = [recording.names.index(name) for name in traces.names]
    places, times = recording.positions[:, columns], recording.times
    seen = np.isfinite(places).all(axis=2)
    origin = places[np.argmax(seen, axis=0), np.arange(len(columns))]
    what = "first frame"
    if window is not None:
        start, stop = window
        inside = (times >= start) & (times <= stop)
        what = "mean"
        origin = np.ma.masked_invalid(places[inside]).mean(axis=0).filled(np.nan)
        # Positions outside the window may be far away, and are cut off.
        off = np.linalg.norm(places[inside] - origin, axis=2)
        axes.set_ylim(0.0, 3e3 * max(np.nanmax(off, initial=0.0), 1e-6))
        frame = float(np.median(np.diff(times))) if times.size > 1 else 1.0
        beside = max(_AROUND * (stop - start), _SHORTEST * frame)
        axes.set_xlim(start - beside, stop + beside)
    away = 1e3 * np.linalg.norm(places - origin, axis=2)
    few = len(columns) <= _MOST_NAMES
    for i, name in enumerate(traces.names):
        colour, dashes = SERIES[i % len(SERIES)], "-" if i < len(SERIES) else "--"
        label = name if few else None
        axes.plot(times, away[:, i], dashes, color=colour, label=label)
    look = {"fontsize": "small", "color": FAINT, "va": "top", "parse_math": False}
    where = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
    for event, time in recording.events:
        axes.axvline(time, color=FAINT, ls=":")
        place = {**where, "xytext": (3, -3), "annotation_clip": True}
        axes.annotate(event, (time, 1.0), **place, **look)
    axes.set(xlabel="time [s]", ylabel=f"distance from\n{what} [mm]")
    return figures.draw_grid(axes)


def draw_trials(
    axes: Axes,
    where: Sequence[float] | Sequence[str],
    values: Float[HostArray, " n"],
    *,
    axis: str = "",
    name: str = "",
    unit: str = "",
    truth: Float[HostArray, " n"] | None = None,
    on_bound: Bool[HostArray, " n"] | None = None,
) -> Axes:
    """Draw a figure of some trials over their values on an axis: one dot per trial.

    Numbers make a scatter; words make groups, each with a bar at its mean.

    Args:
        axes: Where to draw; the unit of its ticks is the one that reads best.
        where: Value of each trial on the axis.
        values: The figure, in SI; nan is not drawn.
        axis: Name of the axis.
        name: Name of the figure.
        unit: SI unit of the figure.
        truth: True value of each trial, in SI, as a dashed line; nan where there is
            none.
        on_bound: Whether the value stands on a bound: an open square instead of a dot.

    Returns:
        The axes, with labels for a legend.
    """
    truth = np.full(len(values), np.nan) if truth is None else truth
    on_bound = np.zeros(len(values), bool) if on_bound is None else on_bound
    factor, shown = readable_unit([*values, *truth], unit)
    values, truth = factor * values, factor * truth
    label = f"{escaped(name)} [{shown}]" if shown not in ("", "-") else escaped(name)
    axes.set_ylabel(label, parse_math=False)
    axes.set_xlabel(escaped(axis), parse_math=False)
    figures.draw_grid(axes)
    spans = {}
    if all(map(is_number, where)):
        places = np.asarray(where, float)
        axes.margins(0.06)
        ticks = sorted(set(where))
        if len(ticks) <= _MOST_TICKS:
            axes.set_xticks(ticks, [f"{value:g}" for value in ticks])
        beside = 0.04 * np.ptp(places) or 0.5
        spans[places.min() - beside, places.max() + beside] = truth
    else:
        named = np.array([escaped(str(word)) for word in where])
        groups = list(dict.fromkeys(named.tolist()))
        places, means = np.zeros(len(named)), []
        for i, group in enumerate(groups):
            members = named == group
            good = np.flatnonzero(members & np.isfinite(values))
            # Spread sideways in order, so that equal values do not hide each other.
            places[good] = i + np.linspace(-0.25, 0.25, good.size) * (good.size > 1)
            means.append(values[good].mean() if good.size else np.nan)
            spans[i - 0.4, i + 0.4] = truth[members]
        left = np.arange(len(groups)) - 0.35
        axes.hlines(means, left, left + 0.7, color=SERIES[1], label="mean")
        axes.set_xticks(left + 0.35, groups, parse_math=False)
        axes.set_xlim(-0.6, len(groups) - 0.4)
    # One truth of all that stand there, or none.
    true = {e: t[0] for e, t in spans.items() if np.isfinite(t).all() and not np.ptp(t)}
    if true:
        look = {"color": TEXT, "ls": "--", "label": "true value"}
        axes.hlines(list(true.values()), *np.transpose(list(true)), **look)
    dots = {"ls": "none", "marker": "o", "color": SERIES[0], "alpha": 0.55, "mew": 0}
    axes.plot(places[~on_bound], values[~on_bound], **dots)
    if np.any(np.isfinite(values[on_bound])):
        draw_on_bound(axes, places[on_bound], values[on_bound])
    return axes


def plot_panels(
    path: str | Path,
    drawn: Sequence[Callable[[Axes], Axes]],
    *,
    columns: int = 1,
    shared: bool = False,
    lines: float | None = None,
    style: PictureStyle = figures.COLUMN,
    title: str = "",
) -> None:
    """Write charts as one picture, with one legend.

    Args:
        path: PNG, SVG or PDF file.
        drawn: Functions that draw a chart each, row by row.
        columns: Number of charts beside each other.
        shared: Whether the charts of a row have one vertical axis, and those of a
            column one horizontal axis.
        lines: Height of a chart, in lines of its words; by default as suits its width.
        style: Width, size of words, resolution.
        title: Title of the picture.
    """
    from matplotlib.ticker import FixedLocator as Fixed

    rows = math.ceil(len(drawn) / columns)
    line = _LINE * style.font_size
    tall = lines or np.clip(0.4 * style.width_mm / columns / line, 9.0, 16.0)
    height = (rows * tall + 3.5 + 2.0 * bool(title)) * line / style.width_mm
    share: dict[str, Any] = {"sharex": "col", "sharey": "row"} if shared else {}
    with figures.printed(path, style, height=height) as figure:
        panels = figure.subplots(rows, columns, squeeze=False, **share)
        for axes, draw in zip(panels.flat, drawn, strict=True):
            draw(axes)
            if shared:
                axes.label_outer()
        if title:
            look = {"fontsize": "large", "weight": "bold", "color": TEXT}
            figure.suptitle(title, **look, parse_math=False)
        known = [axes.get_legend_handles_labels() for axes in panels.flat]
        entries = {word: h for pair in known for h, word in zip(*pair, strict=True)}
        if entries:
            handles = list(entries.values())
            figures.add_legend(figure, handles, figure.bbox.width, "outside lower left")
        figure.align_ylabels()
        named = [
            a for a in panels.flat if isinstance(a.xaxis.get_major_locator(), Fixed)
        ]
        if named:
            figure.draw_without_rendering()  # which places the words
        for axes in named:
            boxes = [label.get_window_extent() for label in axes.get_xticklabels()]
            if any(a.padded(2.0).overlaps(b) for a, b in itertools.pairwise(boxes)):
                axes.tick_params(axis="x", labelrotation=90)
