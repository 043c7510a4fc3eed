"""Results of inverse control: their tables, which a cell and a page show alike."""

from collections.abc import Sequence
from itertools import compress

import numpy as np

from softcal_jax._text_table import Cell, TextTable, text_table
from softcal_jax._typing import Float, HostArray
from softcal_jax.control import GoalFit, InverseResult, TrajectoryResult
from softcal_jax.export import readable_values
from softcal_jax.identifiability import RunVerdict
from softcal_jax.report._charts import goal_chart
from softcal_jax.report._html import Html, bullets, sentences, table_html
from softcal_jax.report._robot import actuator_row


def inverse_verdict(result: InverseResult | TrajectoryResult) -> RunVerdict:
    """Say whether the goals are met, and by which command."""
    if isinstance(result, TrajectoryResult):
        missed = tuple(result.points[i].message for i in result.unmet)
        tone = "doubtful" if missed or not result.points else "good"
        return RunVerdict(result.headline, tone, missed)
    reasons = (f"Commanded: {_inputs(result)}.",)
    return RunVerdict(result.message, "good" if result.met else "doubtful", reasons)


def inverse_html(result: InverseResult | TrajectoryResult) -> list[Html]:
    """Show how close the goals are, and what the actuators do there."""
    if isinstance(result, InverseResult):
        drawn = goal_chart([(_titled(fit), fit) for fit in result.goals], result.tol)
        tables = map(table_html, (goal_table(result.goals), actuator_table(result)))
        limits = "Limits that are reached:" if result.active_limits else ""
        reached = [*sentences([limits]), bullets(result.active_limits)]
        return [*drawn, *tables, *reached]
    rows, goals = [], []
    for i, point in enumerate(result.points, 1):
        outcome = Cell(point.message, "good" if point.met else "bad")
        rows.append((str(i), _inputs(point), outcome))
        goals += [(f"goal {i}, {_titled(fit)}", fit) for fit in point.goals]
    drawn = goal_chart(goals, result.points[0].tol) if goals else []
    columns = "goal", "inputs", "outcome"
    table = text_table("Commands", columns, rows, words=["inputs"])
    return [*drawn, table_html(table)]


def attempts_table(result: InverseResult) -> TextTable:
    """Tabulate the descents of the search."""
    rows = [(own.way, str(own.n_steps), f"{own.error:.3g}") for own in result.attempts]
    columns = "begun from", "steps", "largest error, in standard deviations"
    return text_table("Descents", columns, rows)


def _titled(fit: GoalFit) -> str:
    return f"{fit.name} (turn)" if fit.effector.is_turn else fit.name


def goal_table(goals: Sequence[GoalFit]) -> TextTable:
    """Tabulate goals, what is reached, and how far that is off."""
    rows = [
        (
            _titled(fit),
            _coordinates(fit, fit.effector.measured),
            _coordinates(fit, fit.reached),
            fit.off,
        )
        for fit in goals
    ]
    return text_table("Goals", ("effector", "goal", "reached", "off by"), rows)


def _coordinates(fit: GoalFit, values: Float[HostArray, " k"]) -> str:
    """Write the coordinates that have a goal, with their axes if some have none."""
    own, seen = fit.effector, np.asarray(fit.effector.seen)
    text = readable_values(values[seen].tolist(), own.unit).rstrip()
    if len(seen) == 1 or seen.all():
        return text
    return f"{', '.join(compress('xyz', seen))} = {text}"


def actuator_table(result: InverseResult) -> TextTable:
    """Tabulate what the actuators do, each in its own units."""
    columns = "actuator", "kind", "force", "displacement"
    rows = []
    for own in result.actuators:
        name, *shown = actuator_row(own)
        commanded = name in result.configuration.actuation
        cells = [Cell(text) for text in shown]
        if commanded:
            k = int(own.imposed == "displacement")
            cells[k] = Cell(shown[k], "strong")
        kind = own.kind if commanded else f"{own.kind}, not commanded"
        rows.append((name, kind, *cells))
    return text_table("Actuators", columns, rows)


def _inputs(result: InverseResult) -> str:
    """Write what is commanded."""
    words = []
    for own in result.actuators:
        value, unit = own.force, own.force_unit
        if own.imposed == "displacement":
            assert own.displacement is not None
            assert own.displacement_unit is not None
            value, unit = own.displacement, own.displacement_unit
        if own.name in result.configuration.actuation:
            words.append(f"{own.name} = {readable_values([value], unit)}")
    return ", ".join(words)
