"""Plot the course of a calibration."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from softcal_jax.calibration import CalibrationResult, ParameterEstimate
from softcal_jax.export import readable_estimate, readable_unit
from softcal_jax.plotting._colours import BAD, FAINT, GOOD, SERIES, TEXT

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

_DPI = 100
_MOST_NAMES = 7
"""Most parameters in one panel that get a legend."""


def plot_convergence(
    result: CalibrationResult, path: str | Path, *, name: str = "calibration"
) -> None:
    """Plot the fit, the size of the step and the parameters against the step's index.

    Args:
        result: The calibration.
        path: PNG file, 1200 pixels wide.
        name: Name of the calibration.
    """
    figure = convergence_figure(result, name)
    figure.savefig(path, dpi=_DPI, format="png")


def convergence_figure(
    result: CalibrationResult, name: str
) -> "matplotlib.figure.Figure":
    """Build the figure without a screen and without touching Matplotlib's state."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    units = list(dict.fromkeys(parameter.unit for parameter in result.parameters))
    n = 2 + len(units)
    figure = Figure(figsize=(12.0, 1.2 + 3.0 * n), dpi=_DPI, layout="constrained")
    panels = figure.subplots(n, 1, sharex=True, squeeze=False)[:, 0]
    _plot_rms(panels[0], result)
    _plot_step(panels[1], result)
    for axes, unit in zip(panels[2:], units, strict=True):
        _plot_parameters(axes, result, [q for q in result.parameters if q.unit == unit])
    for axes in panels:
        _mark_rejected(axes, result)
        _finish(axes)
    panels[-1].set_xlabel("step", fontsize=14)
    panels[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    steps = len(result.history) - 1
    if result.converged:
        text = f"{name}: converged in {steps} step{'' if steps == 1 else 's'}"
    else:
        text = f"{name}: NOT converged after {steps} steps, do not use these values"
        figure.set_facecolor("#fdecea")
    figure.suptitle(
        text,
        fontsize=19,
        weight="bold",
        color=GOOD if result.converged else BAD,
        parse_math=False,
    )
    figure.get_layout_engine().set(h_pad=0.12, w_pad=0.12)  # pyright: ignore
    return figure


def _finish(axes: "matplotlib.axes.Axes") -> None:
    axes.grid(True, color="#dddddd", lw=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=13)
    axes.margins(x=0.02)
    axes.yaxis.label.set_fontsize(14)
    if axes.get_legend_handles_labels()[0]:
        # Place it beside the panel, where it covers no curve.
        legend = axes.legend(
            fontsize=13, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.04)
        )
        for text in legend.get_texts():
            text.set_parse_math(False)  # a name may hold a dollar sign


def _steps(result: CalibrationResult) -> list[int]:
    return [entry.step for entry in result.history]


def _plot_rms(axes: "matplotlib.axes.Axes", result: CalibrationResult) -> None:
    fitted = [fit for fit in result.configurations if fit.role == "calibration"]
    if any(fit.points for fit in fitted):
        rms = [1e3 * entry.rms for entry in result.history]
        label, unit = "rms marker\ndistance [mm]", " mm"
    else:  # only lengths, angles or forces were measured
        rms = [entry.cost for entry in result.history]
        label, unit = "cost [-]", ""
    axes.plot(_steps(result), rms, "o-", color=SERIES[0], lw=2, ms=7)
    axes.set_ylabel(label)
    axes.set_ylim(bottom=0.0, top=1.12 * max(rms) or 1.0)
    axes.annotate(
        f"{rms[-1]:.3g}{unit}",
        (result.history[-1].step, rms[-1]),
        xytext=(0, 10),
        textcoords="offset points",
        ha="right",
        fontsize=13,
        color=TEXT,
    )


def _plot_step(axes: "matplotlib.axes.Axes", result: CalibrationResult) -> None:
    history = result.history[1:]  # the start has no step
    # A step of exactly zero has no logarithm; draw it at rounding level.
    sizes = [max(*np.abs(entry.lambda_p), 1e-16) for entry in history]
    axes.semilogy([e.step for e in history], sizes, "o-", color=SERIES[0], lw=2, ms=7)
    tol = result.settings.tol
    axes.axhline(tol, color=FAINT, ls="--", lw=1.8, label=f"tolerance {tol:g}")
    axes.minorticks_off()
    axes.set_ylabel(r"largest $|\lambda_p|$ [-]")


def _plot_parameters(
    axes: "matplotlib.axes.Axes",
    result: CalibrationResult,
    parameters: list[ParameterEstimate],
) -> None:
    values = {q.name: [e.values[q.name] for e in result.history] for q in parameters}
    unit = parameters[0].unit
    shown = readable_unit([v for series in values.values() for v in series], unit)
    named = len(parameters) <= _MOST_NAMES
    for i, parameter in enumerate(parameters):
        estimate = readable_estimate(parameter.value, parameter.standard_error, unit)
        label = f"{parameter.name} = {estimate}"
        if parameter.at_bound:
            label += " (on a bound)"
        axes.plot(
            _steps(result),
            shown.factor * np.array(values[parameter.name]),
            "o-",
            color=SERIES[i % len(SERIES)],
            lw=2 if named else 1,
            ms=7 if named else 4,
            label=label if named else None,
        )
    what = parameters[0].name if len(parameters) == 1 else "parameters"
    axes.set_ylabel(f"{what} [{shown.unit or '-'}]", parse_math=False)


def _mark_rejected(axes: "matplotlib.axes.Axes", result: CalibrationResult) -> None:
    """Draw a band and a cross at every step that was not taken."""
    rejected = [entry.step for entry in result.history if not entry.accepted]
    for i, step in enumerate(rejected):
        axes.axvspan(step - 0.25, step + 0.25, color="#f2c6c0", lw=0, zorder=0)
        axes.plot(
            step,
            0.06,
            "x",
            transform=axes.get_xaxis_transform(),
            color=BAD,
            ms=9,
            mew=2.5,
            ls="none",
            label="step not taken" if i == 0 else None,
        )
