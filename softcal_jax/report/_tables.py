"""Tables of results for a terminal, to be printed by `rich`."""

import math
from typing import TYPE_CHECKING, Any

from softcal_jax.calibration import CalibrationResult, SimulationResult
from softcal_jax.export import readable_estimate, readable_unit
from softcal_jax.identifiability import (
    IDENTIFIABLE_BELOW,
    WEAK_BELOW,
    Assessment,
    Identifiability,
    assess,
)
from softcal_jax.report._cells import add_row, start_table
from softcal_jax.report._robot_tables import effector_table, robot_tables

if TYPE_CHECKING:
    import rich.console
    import rich.table

MOST_DIRECTIONS = 6
"""Most blind directions that are listed; the others are only counted."""

_STYLE = {
    "identifiable": "green",
    "weakly identifiable": "yellow",
    "not identifiable": "bold red",
}


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

    steps = len(result.history) - 1
    verdict = assessment or assess(result)
    found = verdict.identifiability
    if not result.converged:
        text = f"NOT CONVERGED after {steps} steps: do not use these values."
        head = Text(text, style="bold white on red")
    elif verdict.identified:
        text = f"Converged in {steps} steps."
        head = Text(text, style="bold green")
    else:
        # The tables above and the notes below say why.
        text = f"Converged in {steps} steps, but take the values with care."
        head = Text(text, style="bold yellow")
    shown = result.configurations
    parts: list[Any] = [_parameter_table(result, found), _budget_table(result)]
    parts += _interval_table(result)
    parts += _configuration_tables(result)
    parts += [*effector_table(shown), *robot_tables(shown)]
    parts += [*_outlook(found), head]
    if result.starts is not None:
        parts.append(Text(str(result.starts)))
    parts += [Text(f"Note: {note}", style="yellow") for note in result.notes]
    return Group(*parts)


def simulation_table(result: SimulationResult) -> "rich.console.Group":
    """Tabulate a forward simulation for the terminal.

    Args:
        result: The simulation.

    Returns:
        One line per configuration, with the reason if it has no equilibrium; then
        effectors that are not points, actuators, rigid bodies and reactions.
    """
    from rich.console import Group

    table = start_table(
        "Simulation", "configuration", ["largest displacement", "Newton steps"]
    )
    table.add_column("outcome")
    shown = result.configurations
    for own in shown:
        largest = own.largest_displacement if own.converged else math.nan
        style = "green" if own.converged else "bold red"
        steps = str(own.newton_steps)
        add_row(table, own.name, _distance(largest), steps, (own.outcome, style))
    return Group(table, *effector_table(shown), *robot_tables(shown))


def _parameter_table(
    result: CalibrationResult, found: Identifiability
) -> "rich.table.Table":
    blind = {p.name for p in found.parameters if p.verdict == "not identifiable"}
    table = start_table(
        "Parameters", "parameter", ["value ± std. error", "start", "bounds"]
    )
    for q in result.parameters:
        text = readable_estimate(q.value, q.standard_error, q.unit)
        if q.at_bound:
            text += " (on a bound)"
        factor, unit = readable_unit([q.value], q.unit)
        bounds = f"{q.lower * factor:.4g} to {q.upper * factor:.4g} {unit}"
        sound = result.converged and not q.at_bound and q.name not in blind
        style = "bold" if sound else "bold red"
        start = f"{q.start * factor:.4g} {unit}".rstrip()
        add_row(table, q.name, (text, style), start, bounds.rstrip())
    return table


def _budget_table(result: CalibrationResult) -> "rich.table.Table":
    """Tabulate what the standard errors come from."""
    table = start_table("Standard errors by cause", "parameter", [])
    table.add_column("of its value")
    for name in result.budget.names:
        add_row(table, name, result.budget.sentence(name))
    return table


def _interval_table(result: CalibrationResult) -> list["rich.table.Table"]:
    """Tabulate the intervals of the parameters, if there are any."""
    if not result.intervals:
        return []
    level = f"{100.0 * result.intervals[0].level:g} %"
    table = start_table("By profile likelihood", "parameter", [f"{level} interval"])
    for interval in result.intervals:
        ends = (interval.lower_end, interval.upper_end)
        style = "bold red" if "not found" in ends else ""
        add_row(table, interval.name, (str(interval), style))
    return [table]


def _configuration_tables(result: CalibrationResult) -> list["rich.table.Table"]:
    """Tabulate the errors of points and of orientations."""
    columns = ["role", "before", "after", "moved", "after/moved"]
    points = start_table("Rms distance of the markers", "configuration", columns)
    columns = ["role", "before", "after"]
    turns = start_table("Rms angle of the orientations", "configuration", columns)
    for fit in result.configurations:
        before, after, moved = map(
            _distance, (fit.rms_before, fit.rms_after, fit.motion)
        )
        share = "-" if math.isnan(fit.rms_share) else f"{100.0 * fit.rms_share:.1f} %"
        add_row(points, fit.name, fit.role, before, (after, "bold"), moved, share)
        if math.isfinite(fit.turn_after):
            before, after = _angle(fit.turn_before), _angle(fit.turn_after)
            add_row(turns, fit.name, fit.role, before, (after, "bold"))
    sees_points = any(fit.points for fit in result.configurations)
    shown = [points] if sees_points else []
    return shown + ([turns] if turns.row_count else [])


def _outlook(found: Identifiability) -> list[Any]:
    """Tabulate what the data tell about each parameter, and what they are blind to."""
    from rich.text import Text

    table = start_table("What the data tell", "parameter", ["spread left"])
    table.add_column("verdict")
    for p in found.parameters:
        add_row(table, p.name, _percent(p.spread), (p.verdict, _STYLE[p.verdict]))
    legend = (
        f"Spread left by the data, over that of the {found.known}: below "
        f"{_percent(IDENTIFIABLE_BELOW)} identifiable, above {_percent(WEAK_BELOW)} "
        f"not. {str(found.conditioning).splitlines()[0]}"
    )
    return [table, Text(legend), Text(_blindness(found), style=_STYLE[found.verdict])]


def _blindness(found: Identifiability) -> str:
    """Describe the directions of the parameters that the data hardly see."""
    blind = found.blind[::-1]
    if not blind:
        how = "well" if found.verdict == "identifiable" else "only weakly in part"
        return f"The data determine the parameters {how}."
    several = "s" if found.n_parameters > 1 else ""
    lines = [
        f"The data hardly see {len(blind)} of {found.n_parameters} direction{several}; "
        f"along these the {found.known} and the start decide, not the data:"
    ]
    lines += [f"  {d.words} ({_percent(d.spread)})" for d in blind[:MOST_DIRECTIONS]]
    if len(blind) > MOST_DIRECTIONS:
        lines.append(f"  and {len(blind) - MOST_DIRECTIONS} more.")
    lines.append(
        f"They tell more than the {found.known} along {found.informed} of "
        f"{found.n_parameters}."
    )
    return "\n".join(lines)


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


def _angle(radians: float) -> str:
    return "-" if math.isnan(radians) else f"{math.degrees(radians):.2f} deg"


def _distance(metres: float) -> str:
    return "-" if math.isnan(metres) else f"{1e3 * metres:.2f} mm"
