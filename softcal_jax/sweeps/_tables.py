"""A sweep as tables for a terminal, as CSV, and as a picture."""

import csv
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from softcal_jax._text import as_cell
from softcal_jax._text_table import STYLES, Cell, TextTable, Tone, text_table
from softcal_jax._typing import Float, HostArray
from softcal_jax.export import readable_estimate, readable_unit
from softcal_jax.plotting import plot_trials
from softcal_jax.sweeps._result import Group, SweepResult, figure_name, figure_values
from softcal_jax.sweeps._row import TrialRow
from softcal_jax.sweeps._trial import describe, is_number, shown

if TYPE_CHECKING:
    import rich.console

ROUNDING = 1e-9
"""Standard deviation over the mean below which values differ by rounding alone."""

MOST_NAMES = 8
"""Number of figures named below a table; further ones are only counted."""

MOST_PANELS = 4
"""Largest number of figures in a picture by default."""

_NARROW = 24
"""Characters to which a cell with spaces may be wrapped."""

_TONES: dict[str, Tone] = {
    "converged": "plain",
    "not converged": "doubtful",
    "failed": "bad",
}
"""How it is meant that a trial ended so."""


class _Column(NamedTuple):
    """A column of a table, whose header may be wrapped between words."""

    head: str
    cells: list[str]
    words: bool = False

    @property
    def width(self) -> int:
        """Width in characters, with its borders."""
        widths = [len(word) for word in self.head.split()]
        widths += [min(len(c), _NARROW) if " " in c else len(c) for c in self.cells]
        return 3 + max([*widths, 1])


def default_figures(result: SweepResult) -> tuple[str, ...]:
    """Return the figures that are numbers; none if no trial converged."""
    return tuple(f for f in result.figure_names if result.numbers(f).size)


def sweep_table(
    result: SweepResult,
    *,
    by: Sequence[str] | None = None,
    figures: Sequence[str] | None = None,
    every: bool = False,
    width: int = 100,
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
    parts: list[Any] = [Text(f"{result.name}: {headline(result)}", style="bold")]
    if not result.rows:
        return Printed(*parts)
    columns = (
        _trial_columns(result.axes, result.rows) if every else _group_columns(groups)
    )
    room = width - 1 - sum(c.width for c in columns)
    kept = []
    for figure in default_figures(result) if asked is None else asked:
        factor, head = readable_figure(result, figure)
        if every:
            cells = [_trial_cell(row, figure, factor) for row in result.rows]
        else:
            cells = [mean_text(factor * group.numbers(figure)) for group in groups]
        column = _Column(head, cells)
        room -= column.width
        if asked is None and kept and room < 0:
            break
        columns.append(column)
        kept.append(figure)
    tones: list[Tone] = [_TONES[row.state] for row in result.rows] if every else []
    widths = [column.width for column in columns]
    # Where not all fits, `rich` finds which columns to narrow further.
    least = [w - 3 for w in widths] if sum(widths) < width else []
    parts.append(_texts("", columns, tones).drawn(least=least))
    if not every and any(group.count("converged") > 1 for group in groups):
        parts.append(Text("Mean ± standard deviation over the trials that converged."))
    others = [name for name in result.figure_names if name not in kept]
    if others:
        more = len(others) - MOST_NAMES
        listed = ", ".join(others[:MOST_NAMES])
        listed += f" and {more} more" if more > 0 else ""
        parts.append(Text(f"Also kept: {listed} (--figure NAME)."))
    return Printed(*parts, *_reasons(result, every))


def headline(result: SweepResult) -> str:
    """Say how many trials have ended, and how."""
    n, total = len(result.rows), len(result.rows) + len(result.missing)
    counts = Counter(row.state for row in result.rows)
    states = ", ".join(f"{counts[state]} {state}" for state in _TONES if counts[state])
    ended = f": {states}" if states else ""
    return f"{n} of {total} trials have ended{ended}."


def _reasons(result: SweepResult, every: bool) -> list[Any]:
    from rich.text import Text

    found = reasons(result)
    lines = [
        Text(f"{state}, {text}", style=STYLES[_TONES[state]]) for state, text in found
    ]
    if lines and not every:
        lines.append(Text("--all lists every trial."))
    return lines


def reasons(result: SweepResult) -> list[tuple[str, str]]:
    """Write why trials failed or did not converge, each reason once, by the state."""
    rows: dict[tuple[str, str], list[TrialRow]] = {}
    for row in result.rows:
        if row.state != "converged":
            first, *more = row.reason.strip().splitlines() or [""]
            reason = first + (" ..." if more else "")
            rows.setdefault((row.state, reason), []).append(row)
    lines = []
    for (state, reason), own in rows.items():
        n = f"{len(own)} trials, the first" if len(own) > 1 else "1 trial"
        where = describe(own[0].point)
        lines.append((state, f"{n} at {where}: {reason}"))
    return lines


def _group_columns(groups: Sequence[Group]) -> list[_Column]:
    """Make columns of the groups' values, and of how their trials ended."""
    columns = [
        _axis_column(axis, [group.values[axis] for group in groups])
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


def _axis_column(axis: str, values: Sequence[Any]) -> _Column:
    words = not all(map(is_number, values))
    return _Column(axis, list(map(shown, values)), words)


def _trial_columns(axes: Sequence[str], rows: Sequence[TrialRow]) -> list[_Column]:
    """Make columns of each trial's point, and of how it ended."""
    columns = [_axis_column(axis, [row.point[axis] for row in rows]) for axis in axes]
    outcomes = _Column("outcome", [row.state for row in rows], words=True)
    seconds = _Column("time [s]", [f"{row.seconds:.1f}" for row in rows])
    return [*columns, outcomes, seconds]


def group_table(result: SweepResult, figures: Sequence[str]) -> TextTable:
    """Tabulate means over repetitions, for each point."""
    groups = result.groups()
    columns = _group_columns(groups)
    for figure in figures:
        factor, head = readable_figure(result, figure)
        cells = [mean_text(factor * group.numbers(figure)) for group in groups]
        columns.append(_Column(head, cells))
    return _texts("Means", columns)


def trial_table(
    title: str, result: SweepResult, figures: Sequence[str], rows: Sequence[TrialRow]
) -> TextTable:
    """Tabulate some trials of a sweep, with these figures."""
    columns = _trial_columns(result.axes, rows)
    for figure in figures:
        factor, head = readable_figure(result, figure)
        columns.append(
            _Column(head, [_trial_cell(row, figure, factor) for row in rows])
        )
    return _texts(title, columns)


def _texts(
    title: str, columns: Sequence[_Column], tones: Sequence[Tone] = ()
) -> TextTable:
    """Make a table, whose rows may have tones."""
    rows = list(zip(*(column.cells for column in columns), strict=True))
    if tones:
        rows = [
            [Cell(text, tone) for text in row]
            for row, tone in zip(rows, tones, strict=True)
        ]
    heads = [column.head for column in columns]
    return text_table(title, heads, rows, words=[c.head for c in columns if c.words])


def _trial_cell(row: TrialRow, figure: str, factor: float) -> str:
    value = row.figures.get(figure)
    if isinstance(value, int | float):
        return f"{factor * value:.5g}"
    return str(value or "-")


def readable_figure(result: SweepResult, figure: str) -> tuple[float, str]:
    """Return a factor that gives a figure a readable unit, and its name with that."""
    words, unit = figure_name(figure)
    factor, readable = readable_unit(result.numbers(figure), unit)
    return factor, f"{words} [{readable}]" if unit not in ("", "-") else words


def mean_text(values: Float[HostArray, " n"]) -> str:
    """Write mean and standard deviation of values."""
    if not values.size:
        return "-"
    mean = float(np.mean(values))
    spread = float(np.std(values, ddof=1)) if values.size > 1 else float("nan")
    if spread < ROUNDING * abs(mean):
        spread = 0.0
    return readable_estimate(mean, spread, "")


def write_sweep_csv(result: SweepResult, path: str | Path) -> None:
    """Write one line per trial that has ended, for a spreadsheet, with values in SI."""
    figures = result.figure_names
    columns = ["state", "reason", "seconds", "compile_seconds", "worker", "ended"]
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        head = [*result.axes, *columns, *figures, "notes"]
        writer.writerow([as_cell(name) for name in head])
        for row in result.rows:
            point = (row.point[axis] for axis in result.axes)
            cells = [shown(v) if isinstance(v, list) else v for v in point]
            cells += [getattr(row, column) for column in columns]
            cells += [row.figures.get(figure) for figure in figures]  # None: empty
            cells.append(" ".join(row.notes))
            writer.writerow([as_cell(c) if isinstance(c, str) else c for c in cells])


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
    rows, panels = result.rows, {}
    for figure in chosen:
        factor, label = readable_figure(result, figure)
        panels[label] = factor * figure_values(rows, figure)
    columns = {}
    for axis in result.grouping(by):
        values = [row.point[axis] for row in rows]
        numbers = all(map(is_number, values))
        columns[axis] = [float(v) if numbers else shown(v) for v in values]
    good = len(result.of_state("converged"))
    lost = len(rows) - good
    plot_trials(
        columns or {"": ["all"] * len(rows)},
        panels,
        path,
        title=f"{result.name}: {good} trials",
        left_out=f"{lost} more failed or did not converge" if lost else "",
    )
