"""Results as tables for a terminal, printed by `rich`."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from softcal_jax.calibration import CalibrationResult
from softcal_jax.export import (
    readable_estimate,
    readable_unit,
    result_dict,
)
from softcal_jax.identifiability import (
    IDENTIFIABLE_BELOW,
    WEAK_BELOW,
    Identifiability,
    assess,
)
from softcal_jax.report._cells import plain_text, start_table
from softcal_jax.report._robot_tables import effector_table, robot_tables

if TYPE_CHECKING:
    import rich.console
    import rich.table

MOST_DIRECTIONS = 6
"""Blind directions that are listed; more are counted."""

_STYLE = {
    "identifiable": "green",
    "weakly identifiable": "yellow",
    "not identifiable": "bold red",
}


def summary_table(result: CalibrationResult) -> "rich.console.Group":
    """A calibration as tables for the terminal, to be printed by `rich`.

    Args:
        result: The calibration.

    Returns:
        Parameters, configurations, identifiability, verdict and notes.
    """
    from rich.console import Group
    from rich.text import Text

    steps = len(result.history) - 1
    verdict = assess(result)
    found = verdict.identifiability
    if not result.converged:
        text = f"NOT CONVERGED after {steps} steps: do not use these values."
        head = Text(text, style="bold white on red")
    elif verdict.identified:
        text = f"Converged in {steps} steps."
        head = Text(text, style="bold green")
    else:
        # What for stands in the tables above and in the notes below.
        text = f"Converged in {steps} steps, but take the values with care."
        head = Text(text, style="bold yellow")
    entries = result_dict(result)["configurations"]
    parts: list[Any] = [_parameter_table(result, found), *_interval_table(result)]
    parts += _configuration_tables(result, entries)
    parts += [*effector_table(entries), *robot_tables(entries)]
    parts += [*_outlook(found), head]
    if result.starts is not None:
        parts.append(Text(str(result.starts)))
    parts += [Text(f"Note: {note}", style="yellow") for note in result.notes]
    return Group(*parts)


def simulation_table(data: Mapping[str, Any]) -> "rich.console.Group":
    """A forward simulation as tables for the terminal, to be printed by `rich`.

    Args:
        data: What `simulation_dict` returns.

    Returns:
        One line per configuration; one without an equilibrium gives the reason. Then
        effectors that are no points, actuators, rigid bodies and reactions.
    """
    from rich.console import Group

    table = start_table(
        "Simulation", "configuration", ["largest displacement", "Newton steps"]
    )
    table.add_column("outcome")
    for entry in data["configurations"]:
        largest = entry["largest_displacement_mm"]
        table.add_row(
            plain_text(entry["name"]),
            plain_text("-" if largest is None else f"{largest:.2f} mm"),
            plain_text(str(entry["newton_steps"])),
            plain_text(entry["outcome"], "green" if entry["converged"] else "bold red"),
        )
    entries = data["configurations"]
    return Group(table, *effector_table(entries), *robot_tables(entries))


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
        table.add_row(
            plain_text(q.name),
            plain_text(text, style),
            plain_text(f"{q.start * factor:.4g} {unit}".rstrip()),
            plain_text(bounds.rstrip()),
        )
    return table


def _interval_table(result: CalibrationResult) -> list["rich.table.Table"]:
    """Intervals of the parameters, if they were asked for."""
    if not result.intervals:
        return []
    level = f"{100.0 * result.intervals[0].level:g} %"
    table = start_table("By profile likelihood", "parameter", [f"{level} interval"])
    for interval in result.intervals:
        ends = (interval.lower_end, interval.upper_end)
        style = "bold red" if "not found" in ends else ""
        table.add_row(plain_text(interval.name), plain_text(str(interval), style))
    return [table]


def _configuration_tables(
    result: CalibrationResult, entries: Sequence[Mapping[str, Any]]
) -> list["rich.table.Table"]:
    """How far points are off, and by which angle orientations."""
    points = start_table(
        "Rms distance of the markers",
        "configuration",
        ["role", "before", "after", "moved", "after/moved"],
    )
    for entry in entries:
        percent = entry["rms_after_percent_of_motion"]
        moved = entry["motion_mm"]
        points.add_row(
            plain_text(entry["name"]),
            plain_text(entry["role"]),
            plain_text(_distance(entry["rms_before_mm"])),
            plain_text(_distance(entry["rms_after_mm"]), "bold"),
            plain_text(_distance(moved)),
            plain_text("-" if percent is None else f"{percent:.1f} %"),
        )
    turns = start_table(
        "Rms angle of the orientations", "configuration", ["role", "before", "after"]
    )
    for fit in result.configurations:
        if math.isfinite(fit.turn_after):
            turns.add_row(
                plain_text(fit.name),
                plain_text(fit.role),
                plain_text(_angle(fit.turn_before)),
                plain_text(_angle(fit.turn_after), "bold"),
            )
    sees_points = any(fit.marker_names for fit in result.configurations)
    shown = [points] if sees_points else []
    return shown + ([turns] if turns.row_count else [])


def _outlook(found: Identifiability) -> list[Any]:
    """What the data tell about each parameter, and what they are blind to."""
    from rich.text import Text

    table = start_table("What the data tell", "parameter", ["spread left"])
    table.add_column("verdict")
    for p in found.parameters:
        table.add_row(
            plain_text(p.name),
            plain_text(_percent(p.spread)),
            plain_text(p.verdict, _STYLE[p.verdict]),
        )
    legend = (
        f"Spread left by the data, over that of the {found.known}: below "
        f"{_percent(IDENTIFIABLE_BELOW)} identifiable, above {_percent(WEAK_BELOW)} "
        f"not. {str(found.conditioning).splitlines()[0]}"
    )
    return [table, Text(legend), Text(_blindness(found), style=_STYLE[found.verdict])]


def _blindness(found: Identifiability) -> str:
    """The directions of the parameters that the data hardly see."""
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


def _distance(millimetres: float | None) -> str:
    return "-" if millimetres is None else f"{millimetres:.2f} mm"
