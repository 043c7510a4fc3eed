"""What a sweep found: means, best trials, what was varied, and each trial."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from softcal_jax._units import is_number, readable_values
from softcal_jax.results._tree import (
    Chart,
    Column,
    Section,
    Table,
    Tone,
    Value,
    verdict,
)
from softcal_jax.sweeps import SweepResult, figure_name, plot_sweep

MOST_TRIALS, MOST_CHARTED = 100, 6  # in the table, and figures in charts
MOST_COLUMNS = 4  # figures in a table for the terminal
MOST_BEST, MOST_VALUES = 5, 8  # most trials among the best, and most values of an axis

ROUNDING = 1e-9
"""Standard deviation over the mean below which values differ by rounding alone."""

Row = Mapping[str, Any]

_TONES: dict[str, Tone] = {
    "converged": "plain",
    "not converged": "doubtful",
    "failed": "bad",
}
"""Tone in which the end of a trial is shown, by its state."""


def sweep_sections(
    result: SweepResult,
    *,
    by: Sequence[str] | None = None,
    figures: Sequence[str] | None = None,
    every: bool = False,
) -> tuple[Section, ...]:
    """Write the means of a sweep, or all of its trials, and what else there is.

    Args:
        result: The sweep, finished or not.
        by: Axes that trials are grouped by; by default all but repetitions.
        figures: Names of figures; by default the first that are numbers.
        every: One line per trial instead of one per group.

    Raises:
        ValueError: If there is no such axis or figure.
    """
    good = len(result.of_state("converged"))
    bad = len(result.rows) - good
    tone: Tone = "plain" if not bad else "doubtful" if good else "bad"
    chosen = result.numeric_figures[:MOST_COLUMNS]
    if figures is not None:
        chosen = [result.figure(name) for name in figures]
    others = [name for name in result.figures if name not in chosen]
    said = [f"Also kept: {', '.join(others)} (--figure NAME)."] if others else []
    if every:
        shown_rows = trial_table("Trials", result, chosen, result.rows)
    else:
        shown_rows = _mean_table(result, result.groups(by), chosen)
        if len(result.rows) > len(shown_rows.columns[0].content):
            text = "Mean ± standard deviation over the trials that converged."
            said.insert(0, text)
    tables, spread = [shown_rows] if result.rows else [], _spread_table(result)
    none = ["No trial has converged: there is nothing to average."]
    none = none if result.rows and not spread else []
    best, sentence = _best_trials(result)
    varied = [_varied_table(result)]
    return (
        verdict(_headline(result), tone, _doubts(result)),
        Section("notes", "Notes", _notes(result), tone="doubtful"),
        Section("means", "Means over repetitions", said, tables),
        Section("best", "Best trials", sentence, best),
        Section("varied", "What was varied", (), varied, folded=True),
        Section("spread", "Spread of all trials", none, [spread], folded=not none),
    )


def trial_table(
    title: str,
    result: SweepResult,
    figures: Sequence[str],
    rows: Sequence[Row],
) -> Table:
    """Tabulate figures of some trials."""
    points = {axis: [_shown(row[axis]) for row in rows] for axis in result.axes}
    columns = [
        *(Column(axis, values) for axis, values in points.items()),
        Column("outcome", [Value(r["state"], tone=_TONES[r["state"]]) for r in rows]),
        Column("time", [row["seconds"] for row in rows], "time"),
    ]
    for figure in figures:
        values = [row[figure] for row in rows]
        columns.append(_column(result, figure, values))
    return Table(title, tuple(columns))


def _column(result: SweepResult, figure: str, content: Sequence[Any]) -> Column:
    """Return values of a figure, under its name; an axis may have that, too."""
    words, unit = figure_name(figure)
    words += " found" * (words in result.axes)
    return Column(words, content, unit.strip("-"), digits=5)


def _mean_table(
    result: SweepResult,
    groups: Sequence[tuple[Mapping[str, Any], SweepResult]],
    figures: Sequence[str],
) -> Table:
    """Tabulate the means of figures over groups of trials."""
    axes = groups[0][0] if groups else ()
    of = lambda part, state: len(part.of_state(state))
    counts = {
        "trials": [len(part.rows) for _, part in groups],
        "not converged": [of(part, "not converged") for _, part in groups],
        "failed": [of(part, "failed") for _, part in groups],
        "to do": [len(part.missing) for _, part in groups],
    }
    columns = [
        Column(axis, [_shown(point[axis]) for point, _ in groups]) for axis in axes
    ]
    columns += [
        Column(name, n, "count")
        for name, n in counts.items()
        if name == "trials" or any(n)
    ]
    for figure in figures:
        means = [_mean(part, figure) for _, part in groups]
        columns.append(_column(result, figure, means))
    return Table("Means", tuple(columns))


def _mean(part: SweepResult, figure: str, unit: str | None = None) -> Value:
    """Return the mean of a figure, and the standard deviation of several values."""
    values = part.numbers(figure)
    mean = float(np.mean(values)) if values.size else None
    spread = float(np.std(values, ddof=1)) if values.size > 1 else np.nan
    alike = mean and spread < ROUNDING * abs(mean)
    return Value(mean, unit, 0.0 if alike else spread)


def _doubts(result: SweepResult) -> Iterator[str]:
    """Say what failed, did not converge or is left to do."""
    if bad := len(result.rows) - len(result.of_state("converged")):
        what = "trial" if bad == 1 else "trials"
        yield (
            f"{bad} {what} failed or did not converge, and count in no mean, chart or "
            "best value."
        )
    yield from (f"{state.capitalize()}, {text}" for state, text in _trouble(result))
    if left := len(result.missing):
        what = "trial is" if left == 1 else "trials are"
        yield f"{left} {what} left to do: the same command resumes from here."


def _headline(result: SweepResult) -> str:
    """Say how many trials have ended, and how."""
    n, total = len(result.rows), len(result.rows) + len(result.missing)
    counts = Counter(row["state"] for row in result.rows)
    how = (f"{counts[state]} {state}" for state in _TONES if counts[state])
    ended = f": {', '.join(how)}" if n else ""
    return f"{n} of {total} trials have ended{ended}."


def _trouble(result: SweepResult) -> tuple[tuple[str, str], ...]:
    """Say why trials failed or did not converge, each reason once, after the state."""
    rows: dict[tuple[str, str], list[Row]] = {}
    for row in result.rows:
        if row["state"] != "converged":
            first, *more = row["reason"].strip().splitlines() or [""]
            reason = first + (" ..." if more else "")
            rows.setdefault((row["state"], reason), []).append(row)
    many = lambda n: "1 trial" if n == 1 else f"{n} trials, the first"
    return tuple(
        (state, f"{many(len(alike))} at {_point(result, alike[0])}: {reason}")
        for (state, reason), alike in rows.items()
    )


def _notes(result: SweepResult) -> tuple[str, ...]:
    """Return the notes of trials that converged, each with the number of these."""
    rows = result.of_state("converged")
    counts = Counter(note for row in rows for note in row["notes"])
    many = lambda n: "1 trial" if n == 1 else f"{n} trials"
    return tuple(f"{note} ({many(n)})" for note, n in counts.items())


def _varied_table(result: SweepResult) -> Table:
    """Tabulate the axes, with their values."""
    points = [*result.rows, *result.missing]
    rows = []
    for axis in result.axes:
        values = [point[axis] for point in points]
        texts = list(dict.fromkeys(map(_shown, values)))
        listed = "; ".join(texts[:MOST_VALUES])
        if len(texts) > MOST_VALUES:
            listed += "; ..."
            if all(map(is_number, values)):
                listed = f"from {_shown(min(values))} to {_shown(max(values))}"
        repeats = "repetition" if axis in result.repeats else "factor"
        rows.append((axis, repeats, len(texts), listed))
    return Table.of("Axes", "axis | kind | values | which", rows)


def _best_trials(result: SweepResult) -> tuple[tuple[Table, ...], tuple[str, ...]]:
    """Rank trials by the error of the prediction, or else by the error of the fit.

    Returns:
        A table, and the smallest error and its point in words; nothing without errors.
    """
    error = result.error_figure
    if error is None:
        return (), ()
    values = result.values(error)
    order = [
        i for i in np.argsort(values, kind="stable").tolist() if values[i] == values[i]
    ]
    ranked = [result.rows[i] for i in order[:MOST_BEST]]
    words, unit = figure_name(error)
    least = readable_values([float(values[order[0]])], unit).rstrip()
    text = f"The lowest {words} of {len(order)} trials is {least}, "
    table = trial_table("Best trials", result, result.robot_figures, ranked)
    return (table,), (f"{text}at {_point(result, ranked[0])}.",)


def _spread_table(result: SweepResult) -> Table:
    """Tabulate each figure over all trials that converged."""
    rows = []
    for figure in result.numeric_figures:
        (name, unit), values = figure_name(figure), result.numbers(figure)
        ends = values.min(), np.median(values), values.max()
        unit = unit.strip("-")
        sizes = (Value(float(end), unit) for end in ends)
        rows.append((name, values.size, _mean(result, figure, unit), *sizes))
    heads = "figure | trials | mean ± standard deviation | least | median | most"
    return Table.of("Figures of the trials", heads, rows, digits=5)


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _point(result: SweepResult, row: Row) -> str:
    """Write the point of a row in words."""
    return ", ".join(f"{axis} = {_shown(row[axis])}" for axis in result.axes)


def sweep_page_sections(result: SweepResult) -> Iterator[Section]:
    """Write what the page of a sweep says: also charts and each trial."""
    figures = result.robot_figures
    repeated = any(len(part.rows) > 1 for _, part in result.groups())
    for section in sweep_sections(result, figures=figures):
        if repeated or section.key != "means":
            yield section
    yield from _axes(result, figures)
    if result.rows:
        yield _trials(result, figures)


def _axes(result: SweepResult, figures: Sequence[str]) -> Iterator[Section]:
    """Draw the trials over each axis; what has one value in all shows nothing there."""
    good = result.of_state("converged")
    figures = [f for f in figures[:MOST_CHARTED] if np.ptp(result.numbers(f)) > 0.0]
    axes = [a for a in result.axes if len({row[a] for row in good}) > 1]
    for k, axis in enumerate(axes if figures else ()):
        title = f"{', '.join(figure_name(f)[0] for f in figures)} over {axis}"
        plot = partial(plot_sweep, result, by=[axis], figures=figures)
        chart = Chart(title, plot, "One dot per trial.")
        yield Section(f"axis{k}", f"By {axis}", charts=(chart,))


def _trials(result: SweepResult, figures: Sequence[str]) -> Section:
    words = []
    if (more := len(result.rows) - MOST_TRIALS) > 0:
        text = "more are in the folder; softcal sweep show lists all of them with"
        words.append(f"{more} {text} --all.")
    if not_drawn := figures[MOST_CHARTED:]:
        words.append(f"In this table but not plotted: {', '.join(not_drawn)}.")
    few = result.rows[:MOST_TRIALS]
    table = trial_table("Trials", result, figures, few)
    return Section("trials", "All trials", tuple(words), (table,))
