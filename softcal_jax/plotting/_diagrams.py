"""Plot the course of a calibration, and trials against the axes of a sweep."""

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import CalibrationResult, ParameterEstimate
from softcal_jax.export import Readable, readable_unit
from softcal_jax.identifiability import assess, end_of, verdict_of
from softcal_jax.plotting._annotations import draw_name
from softcal_jax.plotting._colours import BAD, COLOUR_OF, FAINT, SERIES, TEXT
from softcal_jax.plotting._save import DPI, save

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

_TITLE_WIDTH = 85
"""Characters of a line of the reasons below the title."""

_LINE = 0.25
"""Height of such a line [inch]."""

_MOST_NAMES = 7
"""Most parameters in one panel that get a legend."""

_MOST_LABELS = 12
"""Most groups on an axis whose labels stay horizontal."""


def plot_convergence(
    result: CalibrationResult, path: str | Path, *, name: str = "calibration"
) -> None:
    """Plot the fit, the size of the step and the parameters against the step's index.

    Args:
        result: The calibration.
        path: PNG file, 1200 pixels wide, or SVG file.
        name: Name of the calibration.
    """
    figure = convergence_figure(result, name)
    save(figure, path)


def convergence_figure(
    result: CalibrationResult, name: str
) -> "matplotlib.figure.Figure":
    """Build the figure without a screen and without touching Matplotlib's state."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    units = list(dict.fromkeys(parameter.unit for parameter in result.parameters))
    n = 2 + len(units)
    figure = Figure(figsize=(12.0, 1.2 + 3.0 * n), dpi=DPI, layout="constrained")
    panels = figure.subplots(n, 1, sharex=True, squeeze=False)[:, 0]
    _plot_rms(panels[0], result)
    _plot_step(panels[1], result)
    for axes, unit in zip(panels[2:], units, strict=True):
        _plot_parameters(axes, result, [q for q in result.parameters if q.unit == unit])
    for axes in panels:
        _mark_noise(axes, result)
        # Draw a band and a cross at every step that was not taken.
        rejected = [entry.step for entry in result.history if not entry.accepted]
        look = {"color": BAD, "ms": 9, "mew": 2.5, "ls": "none"}
        for step in rejected:
            axes.axvspan(step - 0.25, step + 0.25, color="#f2c6c0", lw=0, zorder=0)
            label = "step not taken" if step == rejected[0] else None
            where = axes.get_xaxis_transform()
            axes.plot(step, 0.06, "x", transform=where, label=label, **look)
        _finish(axes)
    panels[-1].set_xlabel("step", fontsize=14)
    panels[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    verdict = verdict_of(result, assess(result))
    colour = COLOUR_OF[verdict.tone]
    if not result.converged:
        figure.set_facecolor("#fdecea")
    text = "\n".join([name, verdict.sentence])
    figure.suptitle(text, fontsize=17, weight="bold", color=colour, parse_math=False)
    if verdict.reasons:
        lines = [line for own in verdict.reasons for line in wrap(own, _TITLE_WIDTH)]
        style = {"fontsize": 13, "color": colour, "loc": "left"}
        panels[0].set_title("\n".join(lines), **style, parse_math=False)
        figure.set_figheight(figure.get_figheight() + _LINE * len(lines))
    figure.get_layout_engine().set(h_pad=0.12, w_pad=0.12)  # pyright: ignore
    return figure


def _grid(axes: "matplotlib.axes.Axes", size: float) -> None:
    axes.grid(True, color="#dddddd", lw=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=size)


def _finish(axes: "matplotlib.axes.Axes") -> None:
    _grid(axes, 13)
    axes.margins(x=0.02)
    axes.yaxis.label.set_fontsize(14)
    if axes.get_legend_handles_labels()[0]:
        # Place it beside the panel, where it covers no curve.
        legend = axes.legend(
            fontsize=13, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.04)
        )
        for text in legend.get_texts():
            text.set_parse_math(False)  # a name may hold a dollar sign


def _plot_rms(axes: "matplotlib.axes.Axes", result: CalibrationResult) -> None:
    fitted = [fit for fit in result.configurations if fit.role == "calibration"]
    if any(fit.points for fit in fitted):
        rms = [1e3 * entry.rms for entry in result.history]
        label, unit = "rms marker\ndistance [mm]", " mm"
    else:  # only lengths, angles or forces were measured
        rms = [entry.cost for entry in result.history]
        label, unit = "cost [-]", ""
    steps = [entry.step for entry in result.history]
    axes.plot(steps, rms, "o-", color=SERIES[0], lw=2, ms=7)
    axes.set_ylabel(label)
    axes.set_ylim(bottom=0.0, top=1.12 * max(rms) or 1.0)
    text, style = f"{rms[-1]:.3g}{unit}", {"fontsize": 13, "path_effects": None}
    draw_name(axes, text, (steps[-1], rms[-1]), (0, 10), ha="right", **style)


def _plot_step(axes: "matplotlib.axes.Axes", result: CalibrationResult) -> None:
    history = result.history[1:]  # the start has no step
    # A step of exactly zero has no logarithm; draw it at rounding level.
    sizes = [max(*np.abs(entry.lambda_p), 1e-16) for entry in history]
    axes.semilogy([e.step for e in history], sizes, "o-", color=SERIES[0], lw=2, ms=7)
    tol = result.settings.tol
    if not history:  # the tolerance alone spans no axis
        axes.set_ylim(0.1 * tol, 1.0)
    axes.axhline(tol, color=FAINT, ls="--", lw=1.8, label=f"tolerance {tol:g}")
    style = {"fontsize": 13, "color": TEXT, "loc": "left"}
    axes.set_title(end_of(result), **style, parse_math=False)
    axes.minorticks_off()
    axes.set_ylabel(r"largest $|\lambda_p|$ [-]")


def _mark_noise(axes: "matplotlib.axes.Axes", result: CalibrationResult) -> None:
    """Draw a line where the data are weighed anew: the fit goes on from there."""
    label: str | None = "noise estimated anew"
    for before, entry in itertools.pairwise(result.history):
        if not math.isclose(before.noise_level, entry.noise_level):
            middle = 0.5 * (before.step + entry.step)
            axes.axvline(middle, color=FAINT, ls=":", lw=1.8, label=label)
            label = None


def _plot_parameters(
    axes: "matplotlib.axes.Axes",
    result: CalibrationResult,
    parameters: list[ParameterEstimate],
) -> None:
    values = {q.name: [e.values[q.name] for e in result.history] for q in parameters}
    unit = parameters[0].unit
    shown = readable_unit([v for series in values.values() for v in series], unit)
    named = len(parameters) <= _MOST_NAMES
    size: dict[str, Any] = {"lw": 2, "ms": 7} if named else {"lw": 1, "ms": 4}
    steps = [entry.step for entry in result.history]
    for i, parameter in enumerate(parameters):
        label = f"{parameter.name} = {parameter}"
        if parameter.at_bound:
            label += " (on a bound)"
        style = {"color": SERIES[i % len(SERIES)], "label": label if named else None}
        series = shown.factor * np.array(values[parameter.name])
        axes.plot(steps, series, "o-", **style, **size)
    if named:
        drawn = [shown.factor * v for own in values.values() for v in own]
        _draw_bounds(axes, parameters, drawn, shown)
    what = parameters[0].name if len(parameters) == 1 else "parameters"
    axes.set_ylabel(f"{what} [{shown.unit or '-'}]", parse_math=False)


def _draw_bounds(
    axes: "matplotlib.axes.Axes",
    parameters: list[ParameterEstimate],
    values: Sequence[float],
    shown: Readable,
) -> None:
    """Draw the bounds that lie near the values, and name all of them."""
    span = max(values) - min(values) or 0.1 * abs(max(values)) or 1.0
    low, high = min(values) - 0.05 * span, max(values) + 0.05 * span
    for i, parameter in enumerate(parameters):
        bounds = [shown.factor * parameter.lower, shown.factor * parameter.upper]
        ends = f"{bounds[0]:.4g} to {bounds[1]:.4g} {shown.unit}".rstrip()
        label = f"bounds of {parameter.name}: {ends}"
        # One that is far away would leave no room for the values.
        near = [b for b in bounds if low <= b <= high]
        look = {"color": SERIES[i % len(SERIES)], "ls": "-.", "lw": 1.5}
        for bound in near:
            axes.axhline(bound, **look)
        axes.plot([], [], label=label, **look)
    axes.set_ylim(low, high)


def plot_trials(
    columns: Mapping[str, Sequence[float] | Sequence[str]],
    figures: Mapping[str, Float[HostArray, " n"]],
    path: str | Path,
    *,
    title: str,
    left_out: str,
) -> None:
    """Plot every figure of some trials against every axis.

    Numbers make a scatter; words make groups, each with a bar at its mean.

    Args:
        columns: Values of the trials on each axis, by its name.
        figures: Results of the trials, by the label of the figure; nan is not drawn.
        path: PNG or SVG file.
        title: Title of the picture.
        left_out: Which trials are not drawn, and why; printed below the title.

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
        row[0].set_ylabel(label, fontsize=14, parse_math=False)
    for axes, name in zip(panels[-1], columns, strict=True):
        axes.set_xlabel(name, fontsize=14, parse_math=False)
    drawing.suptitle(title, fontsize=18, weight="bold", color=TEXT, parse_math=False)
    if left_out:
        style = {"fontsize": 13, "color": BAD, "loc": "left"}
        panels[0, 0].set_title(left_out, **style, parse_math=False)
    if any(isinstance(where[0], str) for where in columns.values()):
        bar = Line2D([], [], color=SERIES[1], lw=2.5, label="mean")
        drawing.legend(handles=[bar], loc="upper right", fontsize=13, frameon=False)
    drawing.get_layout_engine().set(h_pad=0.1, w_pad=0.1)  # pyright: ignore
    save(drawing, path)


def _draw(axes: "matplotlib.axes.Axes", where: Sequence[Any], values: Any) -> None:
    _grid(axes, 12)
    dots = {"ls": "none", "marker": "o", "color": SERIES[0], "alpha": 0.55, "ms": 7}
    if not any(isinstance(value, str) for value in where):
        axes.plot(np.asarray(where, float), values, **dots)
        axes.margins(0.06)
        own = sorted(set(where))
        if len(own) <= _MOST_LABELS:
            axes.set_xticks(own, [f"{value:g}" for value in own])
        return
    groups = list(dict.fromkeys(where))
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
    axes.set_xticks(range(len(groups)), groups, rotation=turn, parse_math=False)
    axes.set_xlim(-0.6, len(groups) - 0.4)
