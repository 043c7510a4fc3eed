"""A sweep in tables of texts, and the numbers of its charts, for a page."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from softcal_jax._module import one_line
from softcal_jax._text_table import TextTable, Tone, text_table
from softcal_jax._typing import Float, HostArray
from softcal_jax.sweeps._calibration import FIT, HELD_OUT, is_of_the_fit
from softcal_jax.sweeps._result import SweepResult, figure_values
from softcal_jax.sweeps._row import TrialRow
from softcal_jax.sweeps._tables import (
    default_figures,
    mean_text,
    readable_figure,
    tabulated,
)
from softcal_jax.sweeps._trial import describe, is_number, shown

MOST_BEST, MOST_TRIALS, MOST_VALUES = 5, 100, 8
"""Most trials among the best, in the table of all, and most values of an axis."""

MOST_CHARTED = 6
"""Most figures that are drawn against each axis."""


class SweptAxis(NamedTuple):
    """An axis with more than one value, and figures of the trials that converged.

    Attributes:
        name: Its name.
        values: The value of each trial, as numbers if all are, else in words.
        figures: Figures that vary, by names with readable units; nan where missing.
    """

    name: str
    values: Sequence[float] | Sequence[str]
    figures: Mapping[str, Float[HostArray, " n"]]

    __repr__ = one_line


class SweepSummary(NamedTuple):
    """A sweep as a page shows it. Means and charts are of trials that converged.

    Attributes:
        headline: How many trials have ended, and how.
        tone: How good or bad that is.
        doubts: What failed, did not converge or is left to do.
        notes: Notes of trials that converged, each with the number of such trials.
        varied: What was varied.
        best: Trials with the smallest error; None if there are none with an error.
        best_in_words: The smallest error, and the point at which it is.
        spread: Spread of each figure over all trials.
        groups: Means over repetitions, for each point; None without repetitions.
        trials: All trials, or the first `MOST_TRIALS`.
        more_trials: How many trials are not in that table.
        axes: Values and figures to draw, for each axis.
        not_drawn: Names of figures that are not drawn.
    """

    headline: str
    tone: Tone
    doubts: tuple[str, ...]
    notes: tuple[str, ...]
    varied: TextTable
    best: TextTable | None
    best_in_words: str
    spread: TextTable
    groups: TextTable | None
    trials: TextTable
    more_trials: int
    axes: tuple[SweptAxis, ...]
    not_drawn: tuple[str, ...]

    __repr__ = one_line


def summarise(result: SweepResult) -> SweepSummary:
    """Summarise a sweep, finished or not."""
    good = result.of_state("converged")
    figures = _figures_of_the_robot(result)
    bad = len(result.rows) - len(good)
    groups = result.groups()
    repeated = any(len(group.rows) > 1 for group in groups)
    tone: Tone = "doubtful" if bad else "plain"
    best, best_in_words = _best(result, figures)
    return SweepSummary(
        headline=result.headline,
        tone="bad" if bad and not good else tone,
        doubts=tuple(_doubts(result, bad)),
        notes=_notes(good),
        varied=_varied(result),
        best=best,
        best_in_words=best_in_words,
        spread=_spread(result),
        groups=tabulated("Means", result, figures, groups) if repeated else None,
        trials=tabulated("Trials", result, figures, result.rows[:MOST_TRIALS]),
        more_trials=max(0, len(result.rows) - MOST_TRIALS),
        axes=tuple(_swept(result, good, figures[:MOST_CHARTED])),
        not_drawn=figures[MOST_CHARTED:],
    )


def _figures_of_the_robot(result: SweepResult) -> tuple[str, ...]:
    """Pick the figures that describe the robot, the error of the prediction first."""
    figures = [name for name in default_figures(result) if not is_of_the_fit(name)]
    if HELD_OUT in figures:  # the fit is no test of the model
        figures = [HELD_OUT, *(name for name in figures if name not in (HELD_OUT, FIT))]
    return tuple(figures)


def _doubts(result: SweepResult, bad: int) -> Iterator[str]:
    if bad:
        what = "trial" if bad == 1 else "trials"
        yield (
            f"{bad} {what} failed or did not converge, and count in no mean, chart or "
            "best value."
        )
    yield from (f"{state.capitalize()}, {text}" for state, text in result.reasons)
    if left := len(result.missing):
        what = "trial is" if left == 1 else "trials are"
        yield f"{left} {what} left to do: the same command goes on from here."


def _notes(rows: Sequence[TrialRow]) -> tuple[str, ...]:
    counts = Counter(note for row in rows for note in row.notes)
    many = lambda n: "1 trial" if n == 1 else f"{n} trials"
    return tuple(f"{note} ({many(n)})" for note, n in counts.items())


def _varied(result: SweepResult) -> TextTable:
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


def _best(
    result: SweepResult, figures: tuple[str, ...]
) -> tuple[TextTable | None, str]:
    """Rank trials by the error of the prediction, or else by the error of the fit."""
    error = next((name for name in (HELD_OUT, FIT) if name in figures), None)
    if error is None:
        return None, ""
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
    return tabulated("Best trials", result, figures, ranked), sentence


def _spread(result: SweepResult) -> TextTable:
    """Tabulate each figure over all trials that converged."""
    rows = []
    for figure in default_figures(result):
        factor, name = readable_figure(result, figure)
        values = factor * result.numbers(figure)
        ends = f"{values.min():.5g}", f"{np.median(values):.5g}", f"{values.max():.5g}"
        rows.append((name, str(values.size), mean_text(values), *ends))
    head = ("figure", "trials", "mean ± standard deviation", "least", "median", "most")
    return text_table("Figures of the trials", head, rows)


def _swept(
    result: SweepResult, good: Sequence[TrialRow], figures: Sequence[str]
) -> Iterator[SweptAxis]:
    drawn = {}
    for figure in figures:
        factor, label = readable_figure(result, figure)
        values = factor * figure_values(good, figure)
        if np.nanmax(values) > np.nanmin(values):  # else there is nothing to see
            drawn[label] = values
    for axis in result.axes:
        where: list[Any] = [row.point[axis] for row in good]
        if not all(map(is_number, where)):
            where = list(map(shown, where))
        if drawn and len(set(where)) > 1:
            yield SweptAxis(axis, where, drawn)
