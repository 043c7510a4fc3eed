"""Do intervals hold where something held fixed is wrong? Six errors on four problems.

Problems: one modulus; two moduli of a printed beam; the six of the paper's beam; a
cable beam with a 6-D sensor. Each is measured, with noise of 0.1 mm, on a robot that
really has one of the errors, 1 and 2 widths of the default budget large: Poisson's
ratio (0.05), density (3 %), depth of the clamp (1 mm, by the mesh), direction of
gravity (1 degree), loads and cable forces (2 %). The sixth is to fit linear tets where
the data are of quadratic ones: that error is one width by definition, and two where the
fit is told half of it. Each case is calibrated and assessed as by a user, and asked for
its 95 % intervals.

`covered_percent` is the share of the printed intervals that hold the truth.
`called_identified_but_wrong` counts the cases that `assess` calls identified though an
interval misses. `median_interval_over_needed` relates the half-width of each interval
to the root mean square error of its parameter over all cases of its problem and its
kind of tets. One error at a time in a budget of n equal ones needs sqrt(2.5 / n) of a
standard error, so that honest intervals come to 1.24 sqrt(n), which is 2.8 for the
five that are not the mesh. `right_model_flagged` counts the draws of noise, five of
each problem with nothing wrong, of which `assess` says that the model is.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks._printed import Printed, printed, share_percent
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._wrong_models import WIDTHS, Order, Problem, Wrong, problems
from softcal_jax.calibration import calibrate
from softcal_jax.identifiability import Assessment, assess

SIZES = (1.0, 2.0)
"""Sizes of the errors, in widths of the budget [-]."""

DRAWS = 5
"""Draws of noise of the right model of each problem."""

LINEAR = "linear tets"

OF_DATA = (
    "The data do not determine",
    "The data determine",
    "The data leave",
    "wider than its bounds",
    "ended on a bound",
    "Other values fit as well",
)
"""Words of reasons that doubt the data, not the model."""

GOALS = {
    "covered_percent": Goal("at least", 90.0),
    "called_identified_but_wrong": Goal("at most", 0),
    "median_interval_over_needed": Goal("at most", 3.0),
    "right_model_flagged": Goal("at most", 0),
}


class Trial(NamedTuple):
    """A fit, and what was said of it.

    Attributes:
        problem: The problem.
        error: What is wrong; empty if nothing is.
        size: How wrong, in widths of the budget [-].
        intervals: What is printed.
        assessment: The verdict.
    """

    problem: Problem
    error: str
    size: float
    intervals: tuple[Printed, ...]
    assessment: Assessment

    @property
    def shown(self) -> list[Printed]:
        """The parameters that have an interval."""
        return [i for i in self.intervals if i.kind != "none"]

    @property
    def held(self) -> list[bool]:
        """Whether each of the intervals holds the truth."""
        return [i.off(self.problem.truth[i.name]) <= 1.0 for i in self.shown]

    @property
    def called_identified_but_wrong(self) -> bool:
        """Whether it is called identified though an interval misses."""
        return self.assessment.identified and not all(self.held)

    @property
    def flagged(self) -> bool:
        """Whether the verdict doubts the model, and not only the data."""
        return bool(self.against_the_model)

    @property
    def against_the_model(self) -> list[str]:
        """The reasons of the verdict that doubt the model."""
        doubts_data = lambda reason: any(words in reason for words in OF_DATA)
        return [r for r in self.assessment.reasons if not doubts_data(r)]


def run(options: Options) -> Outcome:
    """All errors in all problems, then right models."""
    wrong, right = [], []
    for problem in problems():
        options.say(problem.title)
        wrong += with_errors(problem, SIZES)
        right += [fit(problem, "", 0.0, seed) for seed in range(DRAWS)]
    return outcome(wrong, right)


def with_errors(problem: Problem, sizes: Sequence[float]) -> list[Trial]:
    """Fits of a problem with every error in every size."""
    return [
        fit(problem, error, size, 100 * k + round(size))
        for k, error in enumerate((*Wrong._fields, LINEAR), start=1)
        for size in sizes
    ]


def fit(problem: Problem, error: str, size: float, seed: int) -> Trial:
    """Calibrate and assess a problem.

    Args:
        problem: The problem.
        error: What is wrong: a field of `Wrong`, linear tets, or nothing.
        size: How wrong, in widths of the budget.
        seed: Seed of the noise.
    """
    order: Order = 1 if error == LINEAR else 2
    real = Wrong(**{error: size}) if error in Wrong._fields else Wrong()
    # The error of linear tets is what it is: a larger one is one that is known less.
    # Quadratic ones have none, since the data are computed with them.
    widths = replace(WIDTHS, mesh=1.0 / size if order == 1 else 0.0)
    measured = problem.measured(real, seed)
    model = problem.fitted_model(order)
    result = calibrate(model, problem.space, measured, uncertain=widths)
    return Trial(problem, error, size, printed(result), assess(result))


def outcome(wrong: Sequence[Trial], right: Sequence[Trial]) -> Outcome:
    """The figures of all fits.

    Args:
        wrong: Fits with something wrong.
        right: Fits of right models.
    """
    ratios = interval_over_needed(wrong)
    asked = sum(len(t.intervals) for t in wrong)
    figures: dict[str, Figure] = {
        "covered_percent": share_percent([h for t in wrong for h in t.held]),
        "called_identified_but_wrong": sum(
            t.called_identified_but_wrong for t in wrong
        ),
        "median_interval_over_needed": float(np.median(ratios)),
        "right_model_flagged": sum(t.flagged for t in right),
        "right_models": len(right),
        "covered_percent_right": share_percent([h for t in right for h in t.held]),
        "intervals_printed_percent": 100.0 * sum(len(t.shown) for t in wrong) / asked,
        "called_identified": sum(t.assessment.identified for t in wrong),
        "fits_with_errors": len(wrong),
    }
    samples = {"interval_over_needed": ratios}
    return Outcome(figures, samples, GOALS, [_by_error(wrong), _flags(right)])


def interval_over_needed(trials: Sequence[Trial]) -> list[float]:
    """Half-widths over root mean square errors, one for each interval."""
    ratios = []
    for title in dict.fromkeys(t.problem.title for t in trials):
        for linear in (False, True):
            group = [
                t
                for t in trials
                if t.problem.title == title and (t.error == LINEAR) == linear
            ]
            for name in group[0].problem.space.names if group else ():
                truth = group[0].problem.truth[name]
                shown = [i for t in group for i in t.shown if i.name == name]
                errors = [i.error(truth) for i in shown]
                needed = float(np.sqrt(np.mean(np.square(errors)))) if shown else 1.0
                ratios += [i.half_width / needed for i in shown]
    return ratios


def _by_error(trials: Sequence[Trial]) -> Table:
    rows = []
    for t in trials:
        offs = [
            f"{i.name} {i.error(t.problem.truth[i.name]) / i.half_width:+.2f}"
            for i in t.shown
        ]
        said = "identified" if t.assessment.identified else "not identified"
        flagged = "doubted" if t.flagged else "-"
        rows.append(
            [t.problem.title, t.error, f"{t.size:g}", ", ".join(offs), said, flagged]
        )
    columns = ["problem", "error", "widths", "errors in half-widths", "verdict"]
    return Table("One thing wrong", [*columns, "the model"], rows)


def _flags(trials: Sequence[Trial]) -> Table:
    rows = [[t.problem.title, reason] for t in trials for reason in t.against_the_model]
    return Table("What is said against right models", ["problem", "reason"], rows)
