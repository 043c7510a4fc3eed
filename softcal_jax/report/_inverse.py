"""What inverse control found: its verdict, tables and poses."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress

import jax
import numpy as np
from rich.console import Group
from rich.text import Text

from softcal_jax._text_table import STYLES, Cell, TextTable, text_table
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import ConfigurationResult, simulation_result
from softcal_jax.control import GoalFit, InverseResult, TrajectoryResult
from softcal_jax.export import readable_values
from softcal_jax.report._html import Part, bullets
from softcal_jax.report._tables import actuator_row, actuator_values
from softcal_jax.report._verdict import RunVerdict


def inverse_verdict(result: InverseResult | TrajectoryResult) -> RunVerdict:
    """Say whether the goals are met, and by which command."""
    if isinstance(result, TrajectoryResult):
        missed = tuple(result.points[i].message for i in result.unmet)
        tone = "doubtful" if missed else "good"
        return RunVerdict(result.headline, tone, missed)
    reasons = (f"Commanded: {_inputs(result)}.",)
    return RunVerdict(result.message, "good" if result.met else "doubtful", reasons)


def inverse_parts(result: InverseResult | TrajectoryResult) -> list[Part]:
    """Show how closely the goals are met, and what the actuators do for it."""
    if isinstance(result, InverseResult):
        tables = goal_table(result.goals), actuator_table(result)
        limits = "Active limits:" if result.active_limits else ""
        return [*tables, limits, bullets(result.active_limits)]
    rows = [
        (str(i), _inputs(point), Cell(point.message, "good" if point.met else "bad"))
        for i, point in enumerate(result.points, 1)
    ]
    columns = "goal", "inputs", "outcome"
    return [text_table("Commands", columns, rows, words=["inputs"])]


def inverse_table(result: InverseResult) -> Group:
    """Tabulate a result of inverse control for the terminal: goals and actuators."""
    verdict = inverse_verdict(result)
    tables = map(TextTable.drawn, (goal_table(result.goals), actuator_table(result)))
    return Group(*tables, Text(verdict.sentence, f"bold {STYLES[verdict.tone]}"))


def goal_table(goals: Sequence[GoalFit]) -> TextTable:
    """Tabulate goals, what is reached, and how far that is off."""
    rows = []
    for fit in goals:
        name = f"{fit.name} (turn)" if fit.effector.is_turn else fit.name
        pair = [_coordinates(fit, x) for x in (fit.effector.measured, fit.reached)]
        worst = f"{np.max(np.abs(fit.in_std), initial=0.0):.2g}"
        rows.append((name, *pair, fit.off, worst))
    columns = "effector", "goal", "reached", "off by", "standard deviations"
    return text_table("Goals", columns, rows)


def _coordinates(fit: GoalFit, values: Float[HostArray, " k"]) -> str:
    """Write the coordinates that have a goal, with their axes if some have none."""
    effector, seen = fit.effector, np.asarray(fit.effector.seen)
    text = readable_values(values[seen].tolist(), effector.unit).rstrip()
    if len(seen) == 1 or seen.all():
        return text
    return f"{', '.join(compress('xyz', seen))} = {text}"


def actuator_table(result: InverseResult) -> TextTable:
    """Tabulate what the actuators do, each in its own units."""
    columns = "actuator", "kind", "force", "displacement"
    rows = []
    for actuator in result.actuators:
        commanded = actuator.name in result.configuration.actuation
        kind = actuator.kind if commanded else f"{actuator.kind}, not commanded"
        rows.append((actuator.name, kind, *actuator_row(actuator)))
    return text_table("Actuators", columns, rows)


def _inputs(result: InverseResult) -> str:
    """Write the commanded forces and displacements of the actuators."""
    return ", ".join(
        f"{actuator.name} = {actuator_values(actuator)[actuator.imposed]}"
        for actuator in result.actuators
        if actuator.name in result.configuration.actuation
    )


def commanded(point: InverseResult, name: str) -> ConfigurationResult:
    """Describe the equilibrium of a command, to compare it with its goals."""
    # On the host: on the device, each shape would compile a program.
    solution = jax.tree.map(lambda leaf: np.asarray(leaf)[None], point.solution)
    solved = simulation_result(point.model, [point.configuration], solution)
    goals = tuple(fit.effector for fit in point.goals)
    (pose,) = solved.configurations
    return replace(pose, name=name, role="command", effectors=goals)
