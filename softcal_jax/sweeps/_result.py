"""What a sweep has found so far, its groups, as CSV and as a picture."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from softcal_jax import _notebook
from softcal_jax._files import write_rows
from softcal_jax._text import check_known
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import is_number
from softcal_jax.plotting import COLUMN, PictureStyle, draw_trials, plot_panels
from softcal_jax.project import parse_in_si
from softcal_jax.sweeps._trial import COLUMNS

if TYPE_CHECKING:
    import pyarrow as pa

State = Literal["converged", "not converged", "failed"]

Row = dict[str, Any]  # a row of the table, by column

FIT, HELD_OUT = "fit rms [m]", "held-out rms [m]"  # figures of how far the model is off
STEPS, COST, ERROR = "steps", "cost [-]", "standard error of"
TO_TRUTH = "distance to truth [-]"  # a figure of trials to which the truth applies
ON_BOUND = "on a bound"  # a figure in words: parameters that ended on one of theirs

MOST_PANELS = 4  # figures in a picture


def figure_name(name: str) -> tuple[str, str]:
    """Split "fit rms [m]" into "fit rms" and its unit; a name without one has ""."""
    match = re.fullmatch(r"(.+?) \[(.+)\]", name)
    return (match[1], match[2]) if match else (name, "")


@dataclass(frozen=True, eq=False)
class SweepResult:
    """Rows of a sweep, finished or not.

    Columns of a row are the axes, then its end, then figures, in SI: `state`
    ("converged", "not converged" or "failed"), `reason` of the last two, `seconds` of
    wall time, `compile_seconds` of it that JAX took to compile, `worker` (machine and
    process), `ended` (in UTC), `notes` to know before figures are used, `traceback`,
    and `point`, all axes as JSON.

    Attributes:
        name: Its name.
        axes: Names of its axes.
        repeats: Axes whose values are mere repetitions, like draws of noise.
        table: Trials that have ended, a row for each, in the order of the plan; those
            that only an earlier plan had come last.
        missing: Points of the trials that have not ended.
        truth: Values that measurements were simulated with, as the sweep file has them.
    """

    name: str
    axes: tuple[str, ...]
    repeats: tuple[str, ...]
    table: "pa.Table"
    missing: tuple[Row, ...] = ()
    truth: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """The rows of the table as dictionaries."""
        return tuple(self.table.to_pylist())

    def of_state(self, state: State) -> tuple[Row, ...]:
        """Return the rows that ended in a state."""
        return tuple(row for row in self.rows if row["state"] == state)

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of all figures."""
        others = {*self.axes, *COLUMNS}
        return tuple(name for name in self.table.column_names if name not in others)

    @property
    def numeric_figures(self) -> tuple[str, ...]:
        """Names of those that are numbers in some trial that converged."""
        return tuple(name for name in self.figures if self.numbers(name).size)

    @property
    def robot_figures(self) -> tuple[str, ...]:
        """Names of those that describe the robot, the error of the prediction first."""
        names = [
            name
            for name in self.numeric_figures
            if name not in (STEPS, COST) and not name.startswith(f"{ERROR} ")
        ]
        if HELD_OUT in names:  # the fit is no test of the model
            names = [HELD_OUT, *(n for n in names if n not in (HELD_OUT, FIT))]
        return tuple(names)

    @property
    def error_figure(self) -> str | None:
        """Name of the error of the prediction, or else of the fit, if there is one."""
        return next((n for n in (HELD_OUT, FIT) if n in self.robot_figures), None)

    def figure(self, name: str) -> str:
        """Return the full name of a figure, like "fit rms [m]" for "fit rms".

        Raises:
            ValueError: If no row has a figure of that name.
        """
        by_words = {figure_name(figure)[0]: figure for figure in self.figures}
        name = name if name in self.figures else by_words.get(name, name)
        check_known("figure", self.figures, name)
        return name

    def values(self, figure: str) -> Float[HostArray, " n"]:
        """Return a figure of each row; nan for no number, or if it did not converge."""
        states, values = self.table["state"].to_pylist(), self.table[figure].to_pylist()
        pairs = zip(states, values, strict=True)
        good = lambda state, v: state == "converged" and is_number(v)
        return np.array([v if good(s, v) else np.nan for s, v in pairs], float)

    def numbers(self, figure: str) -> Float[HostArray, " n"]:
        """Collect a figure of the trials that converged, where it is a number, in SI.

        Raises:
            ValueError: If no row has a figure of that name.
        """
        values = self.values(self.figure(figure))
        return values[~np.isnan(values)]

    def true_values(self, figure: str) -> Float[HostArray, " n"]:
        """Return what the truth says of a figure in each row, in SI; nan if nothing.

        It says nothing of other layouts of control points than its own.
        """
        name, unit = figure_name(figure)
        known = [row.get(TO_TRUTH) is not None for row in self.rows]
        if name not in self.truth:
            return np.full(len(known), np.nan)
        return np.where(known, parse_in_si(self.truth[name], unit.strip("-")), np.nan)

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
    ) -> tuple[tuple[Row, "SweepResult"], ...]:
        """Split it by the axes of `grouping`: their values, and a part of the sweep."""
        by = self.grouping(by)
        groups: dict[str, tuple[Row, list[int], list[Row]]] = {}
        for i, point in enumerate((*self.rows, *self.missing)):
            values = {axis: point[axis] for axis in by}
            _, ended, missing = groups.setdefault(repr(values), (values, [], []))
            if i < len(self.rows):
                ended.append(i)
            else:
                missing.append(point)
        part = lambda ended, missing: replace(
            self, table=self.table.take(np.array(ended, int)), missing=tuple(missing)
        )
        return tuple((point, part(*some)) for point, *some in groups.values())

    def __str__(self) -> str:
        return _notebook.text_of(self)

    def _repr_html_(self) -> str | None:
        return _notebook.html_of(self)


def write_sweep_csv(result: SweepResult, path: str | Path) -> None:
    """Write one line per trial that has ended, for a spreadsheet, with values in SI."""
    *of_row, notes = [name for name in COLUMNS if name not in ("traceback", "point")]
    names = [*result.axes, *of_row, *result.figures, notes]
    text = lambda value: " ".join(value) if isinstance(value, list) else value
    lines = ([text(row[name]) for name in names] for row in result.rows)
    write_rows(Path(path), names, lines)


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
    rows, chosen = result.rows, result.numeric_figures[:MOST_PANELS]
    if figures is not None:
        chosen = [result.figure(name) for name in figures]
    good = len(result.of_state("converged"))
    if not good or not chosen:
        raise ValueError("there is nothing to draw: no trial has converged yet.")
    columns = {axis: [row[axis] for row in rows] for axis in result.grouping(by)}
    columns = columns or {"": ["all"] * len(rows)}
    drawn, bound = [], [str(row.get(ON_BOUND)) for row in rows]
    for figure in chosen:
        name, unit = figure_name(figure)
        about = {
            "values": result.values(figure),
            "name": name,
            "unit": unit,
            "truth": result.true_values(figure),
            "on_bound": np.array([name in b.split("; ") for b in bound]),
        }
        for axis, where in columns.items():
            kind = float if all(map(is_number, where)) else str
            where = list(map(kind, where))
            drawn.append(partial(draw_trials, where=where, axis=axis, **about))
    plot_panels(path, drawn, columns=len(columns), shared=True, style=style)
    return len(rows) - good
