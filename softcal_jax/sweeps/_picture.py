"""A sweep as a picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax.plotting import plot_trials
from softcal_jax.sweeps._result import SweepResult
from softcal_jax.sweeps._row import TrialRow
from softcal_jax.sweeps._tables import default_figures, readable_figure
from softcal_jax.sweeps._trial import shown

MOST_PANELS = 4
"""Largest number of figures in a picture by default."""


def plot_sweep(
    result: SweepResult,
    path: str | Path,
    *,
    by: Sequence[str] | None = None,
    figures: Sequence[str] | None = None,
) -> None:
    """Plot the figures of all trials that converged against the axes.

    Args:
        result: The sweep.
        path: PNG file.
        by: The axes; by default all but repetitions.
        figures: Names of figures; by default the first that are numbers.

    Raises:
        ValueError: If there is no such axis or figure, or no trial has converged.
    """
    chosen = default_figures(result)[:MOST_PANELS]
    if figures is not None:
        chosen = [result.figure(name) for name in figures]
    rows, by = result.rows, result.grouping(by)
    columns = {axis: _column([row.point[axis] for row in rows]) for axis in by}
    good = len(result.of_state("converged"))
    lost = len(rows) - good
    plot_trials(
        columns or {"": ["all"] * len(rows)},
        dict(_values(result, rows, figure) for figure in chosen),
        path,
        title=f"{result.name}: {good} trials",
        left_out=f"{lost} more failed or did not converge" if lost else "",
    )


def _column(values: Sequence[Any]) -> list[float] | list[str]:
    """Return the values as numbers if all are, else as words."""
    number = lambda v: isinstance(v, int | float) and not isinstance(v, bool)
    if all(map(number, values)):
        return [float(value) for value in values]
    return [shown(value) for value in values]


def _values(result: SweepResult, rows: Sequence[TrialRow], figure: str) -> tuple:
    factor, label = readable_figure(result, figure)
    found = [
        row.figures.get(figure) if row.state == "converged" else None for row in rows
    ]
    number = lambda v: factor * v if isinstance(v, int | float) else np.nan
    return label, np.array([number(v) for v in found], float)
