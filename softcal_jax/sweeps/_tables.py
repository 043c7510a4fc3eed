"""A sweep as tables for a terminal, and as CSV."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.export import readable_estimate, readable_unit
from softcal_jax.sweeps._result import Group, SweepResult, figure_name
from softcal_jax.sweeps._row import TrialRow
from softcal_jax.sweeps._trial import describe, shown

if TYPE_CHECKING:
    import rich.console
    import rich.table

WIDTH = 100
"""Default number of characters in a line."""

ROUNDING = 1e-9
"""Standard deviation over the mean below which values differ by rounding alone."""

MOST_NAMES = 8
"""Number of figures named below a table; further ones are only counted."""

_NARROW = 24
"""Characters to which a cell with spaces may be wrapped."""

_STYLE = {"converged": "", "not converged": "yellow", "failed": "red"}


class _Column(NamedTuple):
    """A column of a table, whose header may be wrapped between words."""

    head: str
    cells: list[str]
    justify: Literal["left", "right"] = "right"

    @property
    def width(self) -> int:
        """Width in characters, with its borders."""
        words = [len(word) for word in self.head.split()]
        cells = [
            _NARROW if " " in c and len(c) > _NARROW else len(c) for c in self.cells
        ]
        return 3 + max([*words, *cells, 1])


def default_figures(result: SweepResult) -> tuple[str, ...]:
    """Return the figures that are numbers; none if no trial converged."""
    return tuple(f for f in result.figure_names if result.numbers(f).size)


def sweep_table(
    result: SweepResult,
    *,
    by: Sequence[str] | None = None,
    figures: Sequence[str] | None = None,
    every: bool = False,
    width: int = WIDTH,
) -> "rich.console.Group":
    """Make a table of a sweep for the terminal, to be printed by `rich`.

    Args:
        result: The sweep.
        by: Axes that trials are grouped by; by default all but repetitions.
        figures: Names of figures; by default the first that are numbers and fit.
        every: One line per trial instead of one per group.
        width: Characters in a line.

    Returns:
        The table: means and standard deviations over the trials that converged, how
        many did not, and why.

    Raises:
        ValueError: If there is no such axis or figure.
    """
    from rich.console import Group as Printed
    from rich.text import Text

    asked = None if figures is None else [result.figure(name) for name in figures]
    groups = result.groups(by)
    parts: list[Any] = [Text(_head(result), style="bold")]
    if not result.rows:
        return Printed(*parts)
    styles = [_STYLE[row.state] if every else "" for row in result.rows]
    fixed = _trial_columns(result) if every else _group_columns(groups)
    column = _trial_figure if every else _group_figure
    possible = default_figures(result) if asked is None else asked
    columns = {f: column(result, groups, f) for f in possible}
    room = width - 1 - sum(c.width for c in fixed)
    if asked is None:
        columns = _fitting(columns, room)
    parts.append(_table([*fixed, *columns.values()], styles, width))
    if not every and any(group.count("converged") > 1 for group in groups):
        parts.append(Text("Mean ± standard deviation over the trials that converged."))
    others = [name for name in result.figure_names if name not in columns]
    if others:
        parts.append(Text(f"Also kept: {_listed(others)} (--figure NAME)."))
    return Printed(*parts, *_reasons(result, every))


def _fitting(columns: dict[str, _Column], room: int) -> dict[str, _Column]:
    """Pick the first columns that fit; at least one."""
    kept: dict[str, _Column] = {}
    for figure, column in columns.items():
        room -= column.width
        if kept and room < 0:
            break
        kept[figure] = column
    return kept


def _head(result: SweepResult) -> str:
    n, total = len(result.rows), len(result.rows) + len(result.missing)
    states = [
        f"{len(result.of_state(state))} {state}"
        for state in ("converged", "not converged", "failed")
        if result.of_state(state)
    ]
    ended = f": {', '.join(states)}" if states else ""
    return f"{result.name}: {n} of {total} trials have ended{ended}."


def _listed(names: Sequence[str]) -> str:
    more = len(names) - MOST_NAMES
    listed = ", ".join(names[:MOST_NAMES])
    return listed + (f" and {more} more" if more > 0 else "")


def _reasons(result: SweepResult, every: bool) -> list[Any]:
    """Write why trials failed or did not converge, each reason once."""
    from rich.text import Text

    rows: dict[tuple[str, str], list[TrialRow]] = {}
    for row in result.rows:
        if row.state != "converged":
            rows.setdefault((row.state, _first_line(row.reason)), []).append(row)
    lines = []
    for (state, reason), own in rows.items():
        n = f"{len(own)} trials, the first" if len(own) > 1 else "1 trial"
        where = describe(own[0].point)
        lines.append(Text(f"{state}, {n} at {where}: {reason}", style=_STYLE[state]))
    if lines and not every:
        lines.append(Text("--all lists every trial."))
    return lines


def _first_line(reason: str) -> str:
    """Return the first line of a reason."""
    first, *more = reason.strip().splitlines() or [""]
    return first + (" ..." if more else "")


def _group_columns(groups: Sequence[Group]) -> list[_Column]:
    """Make columns of the groups' values, and of how their trials ended."""
    columns = [
        _Column(axis, [shown(g.values[axis]) for g in groups], "left")
        for axis in groups[0].values
    ]
    counts = {
        "trials": [len(g.rows) for g in groups],
        "not converged": [g.count("not converged") for g in groups],
        "failed": [g.count("failed") for g in groups],
        "to do": [g.missing for g in groups],
    }
    return columns + [
        _Column(name, list(map(str, numbers)))
        for name, numbers in counts.items()
        if name == "trials" or any(numbers)
    ]


def _group_figure(result: SweepResult, groups: Sequence[Group], figure: str) -> _Column:
    factor, head = readable_figure(result, figure)
    return _Column(head, [_mean(factor * g.numbers(figure)) for g in groups])


def _trial_columns(result: SweepResult) -> list[_Column]:
    """Make columns of each trial's point, and of how it ended."""
    columns = [
        _Column(axis, [shown(row.point[axis]) for row in result.rows], "left")
        for axis in result.axes
    ]
    outcomes = [row.state for row in result.rows]
    seconds = [f"{row.seconds:.1f}" for row in result.rows]
    return [
        *columns,
        _Column("outcome", outcomes, "left"),
        _Column("time [s]", seconds),
    ]


def _trial_figure(result: SweepResult, _: Sequence[Group], figure: str) -> _Column:
    factor, head = readable_figure(result, figure)
    cells = []
    for row in result.rows:
        value = row.figures.get(figure)
        number = isinstance(value, int | float)
        cells.append(f"{factor * value:.5g}" if number else str(value or "-"))
    return _Column(head, cells)


def readable_figure(result: SweepResult, figure: str) -> tuple[float, str]:
    """Return a factor that gives a figure a readable unit, and its name with that."""
    words, unit = figure_name(figure)
    factor, readable = readable_unit(result.numbers(figure), unit)
    return factor, f"{words} [{readable}]" if unit not in ("", "-") else words


def _mean(values: Float[HostArray, " n"]) -> str:
    if not values.size:
        return "-"
    mean = float(np.mean(values))
    spread = float(np.std(values, ddof=1)) if values.size > 1 else float("nan")
    if spread < ROUNDING * abs(mean):
        spread = 0.0
    return readable_estimate(mean, spread, "")


def _table(
    columns: Sequence[_Column], styles: Sequence[str], width: int
) -> "rich.table.Table":
    from rich.table import Table
    from rich.text import Text

    table = Table()
    fits = sum(column.width for column in columns) < width
    for column in columns:
        # Text, not str, which would read a name like "[a]" as markup.
        table.add_column(
            Text(column.head),
            justify=column.justify,
            min_width=column.width - 3 if fits else None,
        )
    cells = [column.cells for column in columns]
    for row, style in zip(zip(*cells, strict=True), styles, strict=False):
        table.add_row(*[Text(cell, style=style) for cell in row])
    return table


def write_sweep_csv(result: SweepResult, path: str | Path) -> None:
    """Write one line per trial that has ended, for a spreadsheet, with values in SI.

    Args:
        result: The sweep.
        path: The file; replaced if it exists.
    """
    figures = result.figure_names
    columns = ["state", "reason", "seconds", "compile_seconds", "worker", "ended"]
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*result.axes, *columns, *figures, "notes"])
        for row in result.rows:
            writer.writerow(_csv_cells(row, result.axes, columns, figures))


def _csv_cells(
    row: TrialRow, axes: Sequence[str], columns: Sequence[str], figures: Sequence[str]
) -> list[Any]:
    point = [
        shown(value) if isinstance(value, list) else value
        for value in (row.point[axis] for axis in axes)
    ]
    found = ["" if (v := row.figures.get(f)) is None else v for f in figures]
    own = [getattr(row, column) for column in columns]
    return [*point, *own, *found, " ".join(row.notes)]
