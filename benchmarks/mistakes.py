"""Is a mistake in the data or the project named? All kinds on four robots.

Each robot is measured with noise, a gravity tilted by about a degree and forces off by
about 2 %; then one thing is stated wrongly, it is calibrated as by a user, and
`likely_mistakes` is asked. `named_first_percent` counts a mistake only where the first
one named is of its kind and has its markers, poses, axis or factor.
`named_where_nothing_is_wrong` counts the correct data sets, `nothing_wrong` in all, for
which any mistake is named; `named_where_the_model_is_wrong` does so for fits with
another error, several widths of the budget large: Poisson's ratio, density, depth of
the clamp, direction of gravity, size of the loads. `seconds_over_fit` is the median,
over the fits with a mistake, of the wall time of the search over that of the
calibration; programs are compiled already. `told_by_check_percent` counts the mistakes
that geometry tells and that are named when a project is read, before any fit, with
cables whose guides are out of order among them; `check_warns_where_nothing_is_wrong`
counts the correct data sets with any such line.

`run mistakes --count planted=1 --count right=4` does less.
"""

import re
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks._planted_mistakes import (
    CHECKED,
    MISTAKES,
    Case,
    Noise,
    Robot,
    right,
    robots,
)
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._wrong_models import Wrong, problems
from softcal_jax.actuators import Cable
from softcal_jax.calibration import calibrate
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.fields import ParameterSpace
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.mistakes import Mistake, likely_mistakes
from softcal_jax.project import implausible

COUNTS = {"planted": 2, "right": 200, "others": 2}
"""Draws of each mistake on each robot, correct data sets, and robots with others."""

OTHERS = {"nu": 3.0, "density": 6.0, "clamp": 6.0, "tilt": 6.0, "loads": 6.0}
"""Errors that are no such mistakes, and their sizes, in widths of the budget [-]."""

GOALS = {
    "named_first_percent": Goal("at least", 90.0),
    "named_where_nothing_is_wrong": Goal("at most", 0),
    "told_by_check_percent": Goal("at least", 90.0),
    "check_warns_where_nothing_is_wrong": Goal("at most", 0),
    "seconds_over_fit": Goal("at most", 0.3),
}


_LAW = NeoHookean(2e5, 0.4)


class Trial(NamedTuple):
    """A calibration with a mistake or without, and what was named.

    Attributes:
        robot: Name of the robot.
        what: Name of the mistake.
        named: What was named, the likeliest first.
        is_first: Whether the first is the one that was made.
        fit_s: Wall time of the calibration [s].
        search_s: Wall time of the search [s].
    """

    robot: str
    what: str
    named: tuple[Mistake, ...]
    is_first: bool
    fit_s: float
    search_s: float


def run(options: Options) -> Outcome:
    """All mistakes on all robots and correct data, then other errors."""
    counts = (
        {**dict.fromkeys(COUNTS, 0), **options.counts} if options.counts else COUNTS
    )
    planted, correct, told, warned = [], [], [], 0
    each = robots()
    for k, robot in enumerate(each):
        options.say(robot.name)
        _tried(robot, "", right(robot, np.random.default_rng(0)))  # compiles
        for n, (what, plant) in enumerate(MISTAKES.items()):
            for draw in range(counts["planted"]):
                random = np.random.default_rng([53, k, n, draw])
                planted.append(_tried(robot, what, plant(robot, random)))
        for n, (what, plant) in enumerate(CHECKED.items()):
            for draw in range(counts["planted"]):
                random = np.random.default_rng([55, k, n, draw])
                case = plant(robot, random)
                lines = " ".join(_checked(robot.model, case))
                told.append((what, all(word in lines for word in case.words)))
        share = range(k, counts["right"], len(each))
        for draw in share:
            random = np.random.default_rng([54, draw])
            case = right(robot, random)
            warned += bool(_checked(robot.model, case))
            correct.append(_tried(robot, "", case))
    for draw in range(4 * counts["planted"]):
        guides = _guides(np.random.default_rng([56, draw]))
        told.append(("guides", any("turns back" in line for line in guides)))
    others = _others(counts["others"])
    made = outcome(planted, correct, others)
    figures: dict[str, Figure] = {}
    if told:
        figures["told_by_check_percent"] = _percent([is_told for _, is_told in told])
    if correct:
        figures["check_warns_where_nothing_is_wrong"] = warned
    goals = {name: goal for name, goal in GOALS.items() if name in figures}
    rows = [[what, "told" if is_told else "-"] for what, is_told in told]
    table = Table("Before any fit", ["mistake", "told"], rows)
    return replace(
        made,
        figures={**made.figures, **figures},
        goals={**made.goals, **goals},
        tables=[*made.tables, table],
    )


def _checked(model: Model, case: Case) -> list[str]:
    """Return what is said of a case before any fit."""
    return [*implausible(model, {c.name: c for c in case.poses})]


def _guides(random: np.random.Generator) -> list[str]:
    """Return what is said of a cable along a beam with two of its guides exchanged."""
    n = int(random.integers(4, 8))
    places = np.linspace([0.0, 0.01, 0.015], [0.1, 0.01, 0.015], n)
    places[:, 1:] += 1e-3 * random.standard_normal((n, 2))
    a = int(random.integers(n - 1))
    places[[a, a + 1]] = places[[a + 1, a]]
    cable = Cable("left", places.tolist())
    mesh = beam(0.1, 0.02, 0.02, (4, 1, 1))
    return [*implausible(build_model(mesh, _LAW, density=1e3, actuators=[cable]), {})]


def _others(count: int) -> list[Trial]:
    """Fits of models that lack something else."""
    trials = []
    for problem in problems()[:count]:
        model = problem.fitted_model(2)
        for error, size in OTHERS.items():
            poses = problem.measured(Wrong(**{error: size}), seed=52)
            robot = problem.title, model, problem.space
            trials.append(_searched(*robot, "estimated", error, Case(poses)))
    return trials


def _tried(robot: Robot, what: str, case: Case) -> Trial:
    parts = robot.name, robot.model, robot.space, robot.noise
    return _searched(*parts, what, case)


def _searched(
    name: str, model: Model, space: ParameterSpace, noise: Noise, what: str, case: Case
) -> Trial:
    """Calibrate as a user does, and ask for the mistake."""
    begun = time.perf_counter()
    fit = calibrate(model, space, case.poses, noise=noise)
    fitted = time.perf_counter()
    named = likely_mistakes(fit)
    searched = time.perf_counter()
    is_first = bool(named) and _is(named[0], case)
    return Trial(name, what, named, is_first, fitted - begun, searched - fitted)


def _is(mistake: Mistake, case: Case) -> bool:
    """Whether a mistake is the one that was made."""
    whole = [rf"(?<!\w){re.escape(word)}(?!\w)" for word in case.words]
    said = all(re.search(word, mistake.change) for word in whole)
    return mistake.kind == case.kind and said


def outcome(
    planted: Sequence[Trial], correct: Sequence[Trial], others: Sequence[Trial]
) -> Outcome:
    """The figures of all calibrations."""
    figures: dict[str, Figure] = {}
    ratios = [t.search_s / t.fit_s for t in planted]
    if planted:
        figures["named_first_percent"] = _percent([t.is_first for t in planted])
        of_all = [any(t.named) for t in planted]
        figures["something_named_percent"] = _percent(of_all)
        figures["seconds_over_fit"] = float(np.median(ratios))
        for what in dict.fromkeys(t.what for t in planted):
            name = what.replace(" ", "_")
            of_kind = [t.is_first for t in planted if t.what == what]
            figures[f"{name}_percent"] = _percent(of_kind)
    if correct:
        figures["named_where_nothing_is_wrong"] = sum(bool(t.named) for t in correct)
        figures["nothing_wrong"] = len(correct)
    if others:
        figures["named_where_the_model_is_wrong"] = sum(bool(t.named) for t in others)
        figures["models_wrong"] = len(others)
    goals = {name: goal for name, goal in GOALS.items() if name in figures}
    samples = {"seconds_over_fit": ratios} if ratios else {}
    return Outcome(figures, samples, goals, [_table([*planted, *correct, *others])])


def _percent(flags: Sequence[bool]) -> float:
    return 100.0 * float(np.mean(flags))


def _table(trials: Sequence[Trial]) -> Table:
    rows = [
        [
            t.robot,
            t.what,
            "first" if t.is_first else "-",
            str(t.named[0]) if t.named else "-",
            f"{t.fit_s:.2f}",
            f"{t.search_s:.2f}",
        ]
        for t in trials
        if t.what or t.named
    ]
    columns = ["robot", "mistake", "named", "the first that was named"]
    return Table("Mistakes", [*columns, "fit [s]", "search [s]"], rows)
