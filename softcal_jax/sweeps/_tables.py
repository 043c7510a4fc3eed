"""A sweep as tables and sentences, as CSV, and as a picture."""

import csv
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group as Printed
from rich.text import Text

from softcal_jax._text import as_cell
from softcal_jax._text_table import STYLES, Cell, TextTable, Tone, text_table
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import is_number
from softcal_jax.export import readable_estimate, readable_unit
from softcal_jax.plotting import (
    COLUMN,
    PictureStyle,
    draw_trials,
    plot_panels,
)
from softcal_jax.sweeps._calibration import FIT, HELD_OUT, is_of_the_fit
from softcal_jax.sweeps._result import Group, SweepResult, figure_name, figure_values
from softcal_jax.sweeps._row import ON_BOUND, OUT_OF_RANGE, TrialRow, flat_columns
from softcal_jax.sweeps._trial import describe, shown

ROUNDING = 1e-9
"""Standard deviation over the mean below which values differ by rounding alone."""

MOST_COLUMNS = MOST_PANELS = 4
"""Largest numbers of figures in a table for the terminal, and in a picture."""

MOST_BEST, MOST_VALUES = 5, 8  # most trials among the best, and most values of an axis

_TONES: dict[str, Tone] = {
    "converged": "plain",
    "not converged": "doubtful",
    "failed": "bad",
}
"""Tone in which the end of a trial is shown, by its state."""

Lines = Sequence[Group] | Sequence[TrialRow]
"""What the lines of a table are: groups of trials, or single ones."""


def default_figures(result: SweepResult) -> tuple[str, ...]:
    """Return the figures that are numbers; none if no trial converged."""
    return tuple(f for f in result.figure_names if result.numbers(f).size)


def _chosen(
    result: SweepResult, figures: Sequence[str] | None, most: int
) -> Sequence[str]:
    """Return figures by their names, or the first few."""
    if figures is None:
        return default_figures(result)[:most]
    return [result.figure(name) for name in figures]


def _places(rows: Sequence[TrialRow], axis: str) -> list[float] | list[str]:
    """Return where trials stand on an axis: as numbers if all are, else in words."""
    values = [row.point[axis] for row in rows]
    if all(map(is_number, values)):
        return list(map(float, values))
    return list(map(shown, values))


def sweep_table(
    result: SweepResult,
    *,
    by: Sequence[str] | None = None,
    figures: Sequence[str] | None = None,
    every: bool = False,
) -> Printed:
    """Make a table of a sweep for the terminal, to be printed by `rich`.

    Args:
        result: The sweep.
        by: Axes that trials are grouped by; by default all but repetitions.
        figures: Names of figures; by default the first that are numbers.
        every: One line per trial instead of one per group.

    Returns:
        The table: means and standard deviations over the trials that converged, how
        many did not, and why.

    Raises:
        ValueError: If there is no such axis or figure.
    """
    chosen = _chosen(result, figures, MOST_COLUMNS)
    grouped = result.groups(by)
    parts: list[Any] = [Text(f"{result.name}: {result.headline}", style="bold")]
    if not result.rows:
        return Printed(*parts)
    tones: list[Tone] = [_TONES[row.state] for row in result.rows if every]
    lines = result.rows if every else grouped
    parts.append(tabulated("", result, chosen, lines, tones=tones).drawn())
    if not every and any(group.count("converged") > 1 for group in grouped):
        parts.append(Text("Mean ± standard deviation over the trials that converged."))
    others = [name for name in result.figure_names if name not in chosen]
    if others:
        parts.append(Text(f"Also kept: {', '.join(others)} (--figure NAME)."))
    bad = [
        Text(f"{state}, {text}", style=STYLES[_TONES[state]])
        for state, text in result.reasons
    ]
    if bad and not every:
        bad.append(Text("--all lists every trial."))
    return Printed(*parts, *bad)


def _cell(line: Group | TrialRow, figure: str, factor: float) -> str:
    """Write a figure of a trial, or its mean over the trials of a group."""
    if isinstance(line, Group):
        if any(row.figures.get(figure) == OUT_OF_RANGE for row in line.rows):
            return OUT_OF_RANGE
        return mean_text(factor * line.numbers(figure))
    value = line.figures.get(figure)
    return f"{factor * value:.5g}" if isinstance(value, int | float) else value or "-"


def tabulated(
    title: str,
    result: SweepResult,
    figures: Sequence[str],
    lines: Lines,
    *,
    tones: Sequence[Tone] = (),
) -> TextTable:
    """Tabulate figures of some trials, or their means over groups of trials."""
    rows = [line for line in lines if isinstance(line, TrialRow)]
    groups = [line for line in lines if isinstance(line, Group)]
    points = [row.point for row in rows] + [group.values for group in groups]
    axes = groups[0].values if groups else result.axes
    columns = [(axis, [shown(point[axis]) for point in points]) for axis in axes]
    if groups:
        counts = {
            "trials": [len(group.rows) for group in groups],
            "not converged": [group.count("not converged") for group in groups],
            "failed": [group.count("failed") for group in groups],
            "to do": [group.missing for group in groups],
        }
        used = {name: n for name, n in counts.items() if name == "trials" or any(n)}
        columns += [(name, list(map(str, numbers))) for name, numbers in used.items()]
    else:
        columns.append(("outcome", [row.state for row in rows]))
        columns.append(("time [s]", [f"{row.seconds:.1f}" for row in rows]))
    for figure in figures:
        factor, head = readable_figure(result, figure)
        columns.append((head, [_cell(line, figure, factor) for line in lines]))
    heads, texts = zip(*columns, strict=True)
    toned = zip(*texts, tones or ("plain",) * len(lines), strict=True)
    cells = [[Cell(text, tone) for text in row] for *row, tone in toned]
    words = [a for a in axes if not all(is_number(point[a]) for point in points)]
    return text_table(title, heads, cells, words=words)


def readable_figure(result: SweepResult, figure: str) -> tuple[float, str]:
    """Return the factor to a figure's readable unit, and its name with that unit."""
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
    groups = flat_columns(result.axes, result.rows)
    columns = [column for group in groups for column in group.items()]
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([as_cell(name) for name, _ in columns])
        # None: an empty cell.
        for cells in zip(*(values for _, values in columns), strict=True):
            writer.writerow([as_cell(c) if isinstance(c, str) else c for c in cells])


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
    rows, chosen = result.rows, _chosen(result, figures, MOST_PANELS)
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


def doubts(result: SweepResult) -> Iterator[str]:
    """Say what failed, did not converge or is left to do."""
    if bad := len(result.rows) - len(result.of_state("converged")):
        what = "trial" if bad == 1 else "trials"
        yield (
            f"{bad} {what} failed or did not converge, and count in no mean, chart or "
            "best value."
        )
    yield from (f"{state.capitalize()}, {text}" for state, text in result.reasons)
    if left := len(result.missing):
        what = "trial is" if left == 1 else "trials are"
        yield f"{left} {what} left to do: the same command resumes from here."


def notes_of_trials(result: SweepResult) -> tuple[str, ...]:
    """Return the notes of trials that converged, each with the number of these."""
    rows = result.of_state("converged")
    counts = Counter(note for row in rows for note in row.notes)
    many = lambda n: "1 trial" if n == 1 else f"{n} trials"
    return tuple(f"{note} ({many(n)})" for note, n in counts.items())


def varied_table(result: SweepResult) -> TextTable:
    """Tabulate the axes, with their values."""
    points = [*result.planned.values(), *(row.point for row in result.rows)]
    rows = []
    for axis in result.axes:
        values = [point[axis] for point in points]
        texts = list(dict.fromkeys(map(shown, values)))
        listed = "; ".join(texts[:MOST_VALUES])
        if len(texts) > MOST_VALUES:
            listed += "; ..."
            if all(map(is_number, values)):
                listed = f"from {shown(min(values))} to {shown(max(values))}"
        repeats = "repetition" if axis in result.repeats else "factor"
        rows.append((axis, repeats, str(len(texts)), listed))
    return text_table("Axes", ("axis", "kind", "values", "which"), rows)


def best_trials(result: SweepResult) -> tuple[str, TextTable] | None:
    """Rank trials by the error of the prediction, or else by the error of the fit.

    Returns:
        The smallest error and its point in words, and a table; None without errors.
    """
    figures = figures_of_the_robot(result)
    error = next((name for name in (HELD_OUT, FIT) if name in figures), None)
    if error is None:
        return None
    values = figure_values(result.rows, error)
    order = [
        int(i) for i in np.argsort(values, kind="stable") if values[i] == values[i]
    ]
    ranked = [result.rows[i] for i in order[:MOST_BEST]]
    factor, name = readable_figure(result, error)
    words, _, unit = name.partition(" [")
    value = f"{factor * values[order[0]]:.4g} {unit.rstrip(']')}".rstrip()
    where = describe(ranked[0].point)
    sentence = f"The lowest {words} of {len(order)} trials is {value}, at {where}."
    return sentence, tabulated("Best trials", result, figures, ranked)


def spread_table(result: SweepResult) -> TextTable:
    """Tabulate each figure over all trials that converged."""
    rows = []
    for figure in default_figures(result):
        factor, name = readable_figure(result, figure)
        values = factor * result.numbers(figure)
        ends = f"{values.min():.5g}", f"{np.median(values):.5g}", f"{values.max():.5g}"
        rows.append((name, str(values.size), mean_text(values), *ends))
    head = ("figure", "trials", "mean ± standard deviation", "least", "median", "most")
    return text_table("Figures of the trials", head, rows)


def swept(result: SweepResult, figures: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return axes and figures of which the trials that converged have several values.

    Of others, there is nothing to see in a chart.
    """
    good = result.of_state("converged")
    axes = [a for a in result.axes if len({shown(row.point[a]) for row in good}) > 1]
    return axes, [f for f in figures if np.ptp(result.numbers(f)) > 0.0]
