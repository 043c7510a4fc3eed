"""Rows of a sweep so far and their groups, as CSV and as a picture."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax import _notebook
from softcal_jax._text import check_known
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import is_number
from softcal_jax.export import write_rows
from softcal_jax.plotting import COLUMN, PictureStyle, draw_trials, plot_panels
from softcal_jax.project import parse_in_si
from softcal_jax.sweeps._row import (
    FIT,
    HELD_OUT,
    ON_BOUND,
    TO_TRUTH,
    State,
    TrialRow,
    flat_columns,
    is_of_the_fit,
)
from softcal_jax.sweeps._trial import shown


def figure_name(name: str) -> tuple[str, str]:
    """Split "fit rms [m]" into "fit rms" and its unit; a name without one has ""."""
    match = re.fullmatch(r"(.+?) \[(.+)\]", name)
    return (match[1], match[2]) if match else (name, "")


@dataclass(frozen=True)
class SweepResult:
    """Rows of a sweep, finished or not.

    Attributes:
        name: Its name.
        axes: Names of its axes.
        repeats: Axes whose values are mere repetitions, like draws of noise.
        planned: Points that are planned, by key, in their order.
        states: How trials ended, by key, in the order of the plan; trials that only an
            earlier plan had come last.
        ended: Rows of these trials, by key in the same order.
        truth: Values that measurements were simulated with, as the sweep file has them.
    """

    name: str
    axes: tuple[str, ...]
    repeats: tuple[str, ...]
    planned: Mapping[str, Mapping[str, Any]]
    states: Mapping[str, State]
    ended: Mapping[str, TrialRow]
    truth: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def rows(self) -> tuple[TrialRow, ...]:
        """Trials that have ended, in the order of `states`."""
        return tuple(self.ended.values())

    @property
    def missing(self) -> tuple[Mapping[str, Any], ...]:
        """Points of the trials that have not ended."""
        return tuple(
            self.planned[key] for key in self.planned if key not in self.states
        )

    def of_state(self, state: State) -> tuple[TrialRow, ...]:
        """Return the rows that ended in a state."""
        return tuple(self.ended[key] for key, s in self.states.items() if s == state)

    @property
    def figure_names(self) -> tuple[str, ...]:
        """Names of all figures, in the order of their first appearance."""
        names = (name for row in self.rows for name in row.figures)
        return tuple(dict.fromkeys(names))

    def numbers(self, figure: str) -> Float[HostArray, " n"]:
        """Collect a figure of the trials that converged, where it is a number, in SI.

        Raises:
            ValueError: If no row has a figure of that name.
        """
        values = figure_values(self.rows, self.figure(figure))
        return values[~np.isnan(values)]

    def true_values(self, figure: str) -> Float[HostArray, " n"]:
        """Return what the truth says of a figure in each row, in SI; nan if nothing.

        It says nothing of other layouts of control points than its own.
        """
        name, unit = figure_name(figure)
        known = np.array([TO_TRUTH in row.figures for row in self.rows], bool)
        if name not in self.truth:
            return np.full(known.shape, np.nan)
        return np.where(known, parse_in_si(self.truth[name], unit.strip("-")), np.nan)

    def figure(self, name: str) -> str:
        """Return the full name of a figure, like "fit rms [m]" for "fit rms".

        Raises:
            ValueError: If no row has a figure of that name.
        """
        by_words = {figure_name(figure)[0]: figure for figure in self.figure_names}
        name = name if name in self.figure_names else by_words.get(name, name)
        check_known("figure", self.figure_names, name)
        return name

    def grouping(self, by: Sequence[str] | None = None) -> tuple[str, ...]:
        """Return the axes that trials are grouped by: by default all but repetitions.

        Raises:
            ValueError: If the sweep has no such axis.
        """
        if by is None:
            return tuple(axis for axis in self.axes if axis not in self.repeats)
        check_known("axis", self.axes, *by)
        return tuple(by)

    def groups(
        self, by: Sequence[str] | None = None
    ) -> tuple[tuple[Mapping[str, Any], "SweepResult"], ...]:
        """Split it by the axes of `grouping`: their values, and a part of the sweep."""
        by = self.grouping(by)
        points = {**self.planned, **{row.key: row.point for row in self.rows}}
        groups: dict[str, list[str]] = {}
        for key, point in points.items():
            groups.setdefault(repr([point[axis] for axis in by]), []).append(key)
        part = lambda values, keys: {key: values[key] for key in keys if key in values}
        return tuple(
            (
                {axis: points[keys[0]][axis] for axis in by},
                replace(
                    self,
                    planned=part(self.planned, keys),
                    states=part(self.states, keys),
                    ended=part(self.ended, keys),
                ),
            )
            for keys in groups.values()
        )

    def __str__(self) -> str:
        return _notebook.text_of(self)

    def _repr_html_(self) -> str | None:
        return _notebook.html_of(self)


def figure_values(rows: Sequence[TrialRow], figure: str) -> Float[HostArray, " n"]:
    """Return a figure of each row; nan for no number, or if it did not converge."""
    value = lambda row: row.figures.get(figure) if row.state == "converged" else None
    return np.array([v if is_number(v) else np.nan for v in map(value, rows)], float)


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
