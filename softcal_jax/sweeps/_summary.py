"""A sweep in sentences and tables, and the numbers of its charts, for a page."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from softcal_jax._text_table import TextTable, text_table
from softcal_jax._typing import Float, HostArray
from softcal_jax.sweeps._calibration import FIT, HELD_OUT, is_of_the_fit
from softcal_jax.sweeps._result import SweepResult, figure_values
from softcal_jax.sweeps._tables import (
    default_figures,
    mean_text,
    readable_figure,
    tabulated,
)
from softcal_jax.sweeps._trial import describe, is_number, shown

MOST_BEST, MOST_VALUES = 5, 8
"""Most trials among the best, and most values of an axis."""


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
        yield f"{left} {what} left to do: the same command goes on from here."


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


def swept_axes(result: SweepResult, figures: Sequence[str]) -> Iterator[SweptAxis]:
    """Yield values and figures to draw, for each axis on which there is any to see."""
    good, drawn = result.of_state("converged"), {}
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
