"""A sweep as CSV, and as a picture."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from softcal_jax._units import is_number
from softcal_jax.export import write_rows
from softcal_jax.plotting import COLUMN, PictureStyle, draw_trials, plot_panels
from softcal_jax.sweeps._calibration import FIT, HELD_OUT, is_of_the_fit
from softcal_jax.sweeps._result import SweepResult, figure_name, figure_values
from softcal_jax.sweeps._row import ON_BOUND, TrialRow, flat_columns
from softcal_jax.sweeps._trial import shown

MOST_PANELS = 4  # figures in a picture


def default_figures(result: SweepResult) -> tuple[str, ...]:
    """Return the figures that are numbers; none if no trial converged."""
    return tuple(f for f in result.figure_names if result.numbers(f).size)


def _places(rows: Sequence[TrialRow], axis: str) -> list[float] | list[str]:
    """Return where trials stand on an axis: as numbers if all are, else in words."""
    values = [row.point[axis] for row in rows]
    if all(map(is_number, values)):
        return list(map(float, values))
    return list(map(shown, values))


def write_sweep_csv(result: SweepResult, path: str | Path) -> None:
    """Write one line per trial that has ended, for a spreadsheet, with values in SI."""
    groups = flat_columns(result.axes, result.rows)
    columns = {name: values for group in groups for name, values in group.items()}
    write_rows(Path(path), [*columns], zip(*columns.values(), strict=True))


def plot_sweep(
    result: SweepResult,
    path: str | Path,
    *,
    by: Sequence[str] | None = None,
    figures: Sequence[str] | None = None,
    style: PictureStyle = COLUMN,
) -> int:
    """Plot the figures of all trials that converged against the axes.

    A dashed line is the true value, where the sweep states it; an open square stands on
    a bound.

    Args:
        result: The sweep.
        path: PNG, SVG or PDF file.
        by: The axes; by default all but repetitions.
        figures: Names of figures; by default the first that are numbers.
        style: Width, size of words, resolution.

    Returns:
        The number of trials that are left out, as they failed or did not converge.

    Raises:
        ValueError: If there is no such axis or figure, or no trial has converged.
    """
    rows, chosen = result.rows, default_figures(result)[:MOST_PANELS]
    if figures is not None:
        chosen = [result.figure(name) for name in figures]
    good = len(result.of_state("converged"))
    if not good or not chosen:
        raise ValueError("there is nothing to draw: no trial has converged yet.")
    columns = {axis: _places(rows, axis) for axis in result.grouping(by)}
    columns = columns or {"": ["all"] * len(rows)}
    drawn, bound = [], [str(row.figures.get(ON_BOUND)) for row in rows]
    for figure in chosen:
        name, unit = figure_name(figure)
        about = {
            "values": figure_values(rows, figure),
            "name": name,
            "unit": unit,
            "truth": result.true_values(figure),
            "on_bound": np.array([name in b.split("; ") for b in bound]),
        }
        for axis, where in columns.items():
            drawn.append(partial(draw_trials, where=where, axis=axis, **about))
    plot_panels(path, drawn, columns=len(columns), shared=True, style=style)
    return len(rows) - good


def figures_of_the_robot(result: SweepResult) -> tuple[str, ...]:
    """Pick the figures that describe the robot, the error of the prediction first."""
    figures = [name for name in default_figures(result) if not is_of_the_fit(name)]
    if HELD_OUT in figures:  # the fit is no test of the model
        figures = [HELD_OUT, *(name for name in figures if name not in (HELD_OUT, FIT))]
    return tuple(figures)
