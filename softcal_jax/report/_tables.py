"""Tables of results for a terminal, to be printed by `rich`."""

import math
from typing import TYPE_CHECKING

from softcal_jax._text_table import STYLES, Cell, TextTable, Tone, text_table
from softcal_jax.calibration import CalibrationResult, SimulationResult
from softcal_jax.control import InverseResult
from softcal_jax.identifiability import Assessment, assess, verdict_of
from softcal_jax.report._calibration import (
    beyond_prior,
    blindness,
    budget_table,
    distance,
    error_tables,
    interval_tables,
    outlook_legend,
    outlook_table,
    outlook_tone,
    parameter_table,
)
from softcal_jax.report._inverse import actuator_table, goal_table, inverse_verdict
from softcal_jax.report._robot import robot_tables

if TYPE_CHECKING:
    import rich.console

_HEADS: dict[Tone, str] = {
    "good": "bold green",
    "doubtful": "bold yellow",
    "bad": "bold white on red",
}
"""Styles of a verdict."""


def summary_table(
    result: CalibrationResult, assessment: Assessment | None = None
) -> "rich.console.Group":
    """Tabulate a calibration for the terminal.

    Args:
        result: The calibration.
        assessment: Its assessment, if known already.

    Returns:
        Parameters, configurations, identifiability, verdict and notes.
    """
    from rich.console import Group
    from rich.text import Text

    own = assessment or assess(result)
    found, verdict = own.identifiability, verdict_of(result, own)
    shown = result.configurations
    first, *directions = blindness(own)
    seen = [first, *(f"  {line}" for line in directions), beyond_prior(found)]
    style = STYLES[outlook_tone(found.verdict, own)]
    tables = [
        parameter_table(result, found),
        budget_table(result),
        *interval_tables(result),
        *error_tables(shown, result.checks),
        *robot_tables(shown),
        outlook_table(own),
    ]
    return Group(
        *map(TextTable.drawn, tables),
        Text(outlook_legend(found)),
        Text("\n".join(filter(None, seen)), style=style),
        *([Text(own.prediction)] if own.prediction else []),
        Text(
            "\n  ".join([verdict.sentence, *verdict.reasons]),
            style=_HEADS[verdict.tone],
        ),
        *([] if result.starts is None else [Text(str(result.starts))]),
        *(Text(line) for line in (result.checks.agreement if result.checks else ())),
        *(Text(f"Note: {note}", style="yellow") for note in result.notes),
    )


def simulation_table(result: SimulationResult) -> "rich.console.Group":
    """Tabulate a forward simulation for the terminal.

    Returns:
        One line per configuration, with the reason if it has no equilibrium; then
        effectors that are not points, actuators, rigid bodies and reactions.
    """
    from rich.console import Group

    return Group(*map(TextTable.drawn, simulation_tables(result)))


def inverse_table(result: InverseResult) -> "rich.console.Group":
    """Tabulate a result of inverse control for the terminal: goals and actuators."""
    from rich.console import Group
    from rich.text import Text

    verdict = inverse_verdict(result)
    style = _HEADS[verdict.tone]
    tables = map(TextTable.drawn, (goal_table(result.goals), actuator_table(result)))
    return Group(*tables, Text(verdict.sentence, style=style))


def simulation_tables(result: SimulationResult) -> list[TextTable]:
    """Tabulate the outcome in every configuration, and what the robot does there."""
    rows = []
    for own in result.configurations:
        largest = own.largest_displacement if own.converged else math.nan
        outcome = Cell(own.outcome, "good" if own.converged else "bad")
        rows.append((own.name, distance(largest), str(own.newton_steps), outcome))
    columns = "configuration", "largest displacement", "Newton steps", "outcome"
    table = text_table("Simulation", columns, rows)
    return [table, *robot_tables(result.configurations)]
