"""A sweep as tables for a terminal, and as CSV."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal_jax.export import readable_estimate, readable_unit
from softcal_jax.sweeps._result import Group, SweepResult, figure_name
from softcal_jax.sweeps._row import TrialRow
from softcal_jax.sweeps._trial import describe, shown

if TYPE_CHECKING:
    import rich.console
    import rich.table

MOST_FIGURES = 5
"""Figures in a table unless others are asked for; more do not fit a terminal."""

MOST_BAD = 10
"""Trials that failed or did not converge, of which a table tells the reason."""


def default_figures(result: SweepResult, most: int) -> tuple[str, ...]:
    """The first figures that are numbers."""
    numbers = [f for f in result.figure_names if result.numbers(f).size]
    return tuple(numbers[:most])


def sweep_table(
    result: SweepResult,
    *,
    by: Sequence[str] | None = None,
    figures: Sequence[str] | None = None,
    every: bool = False,
) -> "rich.console.Group":
    """A sweep as a table for the terminal, to be printed by `rich`.

    Args:
        result: The sweep.
        by: Axes that trials are grouped by; by default all that are no repetitions.
        figures: Which figures; by default the first that are numbers.
        every: One line per trial instead of one per group.

    Returns:
        The table: means and standard deviations over the trials that converged, how
        many did not, and why.

    Raises:
        ValueError: If there is no such axis or figure.
    """
    from rich.console import Group as Printed
    from rich.text import Text

    result.check_figures(figures or ())
    chosen = default_figures(result, MOST_FIGURES) if figures is None else figures
    groups = result.groups(by)
    parts: list[Any] = [Text(_head(result), style="bold")]
    if result.rows:
        parts.append(
            _trial_table(result, chosen)
            if every
            else _group_table(result, groups, chosen)
        )
    if not every and any(group.count("converged") > 1 for group in groups):
        text = "Mean ± standard deviation over the trials that converged."
        parts.append(Text(text))
    others = [name for name in result.figure_names if name not in chosen]
    if others:
        parts.append(Text(f"Also kept (--figure NAME): {', '.join(others)}."))
    bad = [row for row in result.rows if row.state != "converged"]
    for row in [] if every else bad[:MOST_BAD]:
        style = "red" if row.state == "failed" else "yellow"
        text = f"{row.state}: {describe(row.point)}: {_short(row.reason)}"
        parts.append(Text(text, style=style))
    if len(bad) > MOST_BAD and not every:
        text = f"and {len(bad) - MOST_BAD} more that failed or did not converge; --all"
        parts.append(Text(f"{text} lists each trial."))
    return Printed(*parts)


def _head(result: SweepResult) -> str:
    n, total = len(result.rows), len(result.rows) + len(result.missing)
    states = [
        f"{len(result.of_state(state))} {state}"
        for state in ("converged", "not converged", "failed")
        if result.of_state(state)
    ]
    ended = f": {', '.join(states)}" if states else ""
    return f"{result.name}: {n} of {total} trials have ended{ended}."


def _short(reason: str) -> str:
    """The first line of a reason."""
    first, *more = reason.strip().splitlines() or [""]
    return first + (" ..." if more else "")


def _group_table(
    result: SweepResult, groups: Sequence[Group], figures: Sequence[str]
) -> "rich.table.Table":
    table = _table(list(groups[0].values))
    counts = [
        ("trials", lambda g: len(g.rows)),
        ("not converged", lambda g: g.count("not converged")),
        ("failed", lambda g: g.count("failed")),
        ("to do", lambda g: g.missing),
    ]
    counts = [c for c in counts if c[0] == "trials" or any(map(c[1], groups))]
    for name, _ in counts:
        table.add_column(name, justify="right")
    factors = [_figure_column(table, result, figure) for figure in figures]
    for group in groups:
        cells = [shown(value) for value in group.values.values()]
        cells += [str(count(group)) for _, count in counts]
        for figure, factor in zip(figures, factors, strict=True):
            cells.append(_mean(factor * group.numbers(figure)))
        table.add_row(*map(_plain, cells))
    return table


def _trial_table(result: SweepResult, figures: Sequence[str]) -> "rich.table.Table":
    table = _table(list(result.axes))
    factors = [_figure_column(table, result, figure) for figure in figures]
    table.add_column("seconds", justify="right")
    table.add_column("outcome")
    for row in result.rows:
        cells = [shown(row.point[axis]) for axis in result.axes]
        for figure, factor in zip(figures, factors, strict=True):
            value = row.figures.get(figure)
            number = isinstance(value, int | float)
            cells.append(f"{factor * value:.5g}" if number else str(value or "-"))
        outcome = row.state + (f": {_short(row.reason)}" if row.reason else "")
        style = {"converged": "", "not converged": "yellow"}.get(row.state, "red")
        cells.append(f"{row.seconds:.1f}")
        table.add_row(*[_plain(cell, style) for cell in cells], _plain(outcome, style))
    return table


def _figure_column(
    table: "rich.table.Table", result: SweepResult, figure: str
) -> float:
    """A column for a figure; returns the factor on its values."""
    words, unit = figure_name(figure)
    factor, readable = readable_unit(result.numbers(figure), unit)
    head = f"{words} [{readable}]" if unit not in ("", "-") else words
    table.add_column(_plain(head), justify="right")
    return factor


def _mean(values: Any) -> str:
    if not values.size:
        return "-"
    spread = float(np.std(values, ddof=1)) if values.size > 1 else float("nan")
    return readable_estimate(float(np.mean(values)), spread, "")


def _table(axes: Sequence[str]) -> "rich.table.Table":
    from rich.table import Table

    table = Table()
    for axis in axes:
        table.add_column(_plain(axis))
    return table


def _plain(text: str, style: str = "") -> Any:
    """Text as it stands: a name like "[a]" is no markup."""
    from rich.text import Text

    return Text(text, style=style)


def write_sweep_csv(result: SweepResult, path: str | Path) -> None:
    """Writes one line per trial that has ended, for a spreadsheet; values are in SI.

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
