"""Tables of results for a terminal, to be printed by `rich`."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    LeftOut,
    ResidualChecks,
    SimulationResult,
)
from softcal_jax.configurations import EffectorRecord
from softcal_jax.export import readable_unit, readable_values
from softcal_jax.identifiability import (
    Assessment,
    Identifiability,
    assess,
    percent,
)

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

_WORDS = {"role", "effector", "actuator", "rigid body", "state", "of"}
_WORDS |= {"outcome", "verdict", "standard error over the value", "kind"}
"""Columns of words, aligned on the left; numbers are on the right."""

Configurations = Sequence[ConfigurationResult]


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
        head = Text(f"Converged in {steps} steps.", style="bold green")
    else:
        text = f"Converged in {steps} steps, but take the values with care:"
        head = Text("\n  ".join([text, *verdict.reasons]), style="bold yellow")
    moved = [Text(verdict.prediction)] if verdict.prediction else []
    shown = result.configurations
    return Group(
        _parameter_table(result, found),
        _budget_table(result),
        *_interval_table(result),
        *_configuration_tables(shown, result.checks),
        *_robot_tables(shown),
        *_outlook(verdict),
        *moved,
        head,
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

    columns = ["largest displacement", "Newton steps", "outcome"]
    table = _start_table("Simulation", "configuration", columns)
    for own in result.configurations:
        largest = own.largest_displacement if own.converged else math.nan
        outcome = (own.outcome, "green" if own.converged else "bold red")
        _add_row(table, own.name, _distance(largest), str(own.newton_steps), outcome)
    return Group(table, *_robot_tables(result.configurations))


def _parameter_table(
    result: CalibrationResult, found: Identifiability
) -> "rich.table.Table":
    blind = {p.name for p in found.parameters if p.verdict == "not identifiable"}
    columns = ["value ± std. error", "start", "bounds"]
    title = "Parameters" + ("" if result.intervals else ", ± not checked")
    table = _start_table(title, "parameter", columns)
    for q in result.parameters:
        text = q.estimate
        if q.at_bound:
            text += " (on a bound)"
        elif q.given:
            text += f" (with {', '.join(q.given)} on a bound)"
        factor, unit = readable_unit([q.value], q.unit)
        bounds = f"{q.lower * factor:.4g} to {q.upper * factor:.4g} {unit}"
        sound = result.converged and not q.at_bound and q.name not in blind
        style = "bold" if sound else "bold red"
        start = f"{q.start * factor:.4g} {unit}".rstrip()
        _add_row(table, q.name, (text, style), start, bounds.rstrip())
    return table


def _budget_table(result: CalibrationResult) -> "rich.table.Table":
    """Tabulate what the standard errors come from."""
    columns = ["standard error over the value"]
    table = _start_table("Standard errors by cause", "parameter", columns)
    for name in result.budget.names:
        _add_row(table, name, result.budget.sentence(name))
    return table


def _interval_table(result: CalibrationResult) -> list["rich.table.Table"]:
    """Tabulate the intervals of the parameters, and how each was found."""
    if not result.intervals:
        return []
    level = f"{100.0 * result.intervals[0].level:g} %"
    table = _start_table("Intervals", "parameter", [f"{level} interval", "kind"])
    for interval in result.intervals:
        style = "bold red" if interval.kind == "none" else ""
        _add_row(table, interval.name, (str(interval), style), interval.kind)
    return [table]


def _configuration_tables(
    fits: Configurations, checks: ResidualChecks | None
) -> list["rich.table.Table"]:
    """Tabulate the errors of points and of orientations.

    With three or more fitted configurations, points also as the others predict them,
    and in brackets what errors explain of that.
    """
    predicted = {} if checks is None else {own.name: own for own in checks.left_out}
    columns = ["role", "before", "after", "moved", "after/moved"]
    more = ["by the others"] if predicted else []
    title = "Rms distance of the markers"
    points = _start_table(title, "configuration", columns + more)
    turns = _start_table("Rms angle of the orientations", "configuration", columns[:3])
    for fit in fits:
        before, after, moved = map(
            _distance, (fit.rms_before, fit.rms_after, fit.motion)
        )
        share = "-" if math.isnan(fit.rms_share) else f"{100.0 * fit.rms_share:.1f} %"
        by_others = [_by_others(predicted.get(fit.name))] if predicted else []
        row = fit.role, before, (after, "bold"), moved, share, *by_others
        _add_row(points, fit.name, *row)
        if math.isfinite(fit.turn_after):
            before, after = _angle(fit.turn_before), _angle(fit.turn_after)
            _add_row(turns, fit.name, fit.role, before, (after, "bold"))
    shown = [points] if any(fit.points for fit in fits) else []
    return shown + ([turns] if turns.row_count else [])


def _by_others(own: LeftOut | None) -> str:
    """Write how far a prediction by the other configurations is off."""
    if own is None or math.isnan(own.rms):
        return "-"
    return f"{_distance(own.rms)} ({_distance(own.expected)})"


def _robot_tables(configurations: Configurations) -> list["rich.table.Table"]:
    """Tabulate effectors that are not points, actuators, rigid bodies and reactions.

    There is no table for what is missing.
    """
    fitted = any(result.role != "simulation" for result in configurations)
    values = ["measured", "before", "after"] if fitted else ["simulated"]
    titles = {
        "Other effectors": ["effector", *values],
        "Actuators": ["actuator", "force", "displacement"],
        "Rigid bodies": ["rigid body", "state", "moved by", "turned by"],
        "Reactions": ["of", "force of the ground (x, y, z)"],
    }
    tables = [_start_table(t, "configuration", names) for t, names in titles.items()]
    effectors, actuators, bodies, reactions = tables
    for result in configurations:
        for own in result.others:
            if own.is_turn and fitted:
                continue  # another table shows the errors of turns
            name = f"{own.name}{' (turn)' if own.is_turn else ''}"
            found = [own.measured, own.simulated_before, own.simulated][-len(values) :]
            _add_row(effectors, result.name, name, *(_cell(own, v) for v in found))
        robot = result.robot
        if robot is None:
            continue
        for own in robot.actuators:
            shown = [readable_values([own.force], own.force_unit), "-"]
            if own.displacement is not None and own.displacement_unit is not None:
                shown[1] = readable_values([own.displacement], own.displacement_unit)
            shown[own.imposed == "displacement"] += " (imposed)"
            _add_row(actuators, result.name, own.name, *shown)
        for body in robot.bodies:
            moved = readable_values([_length(body.translation)], "m")
            turned = readable_values([_length(body.rotation_vector)], "rad")
            _add_row(bodies, result.name, body.name, body.state, moved, turned)
        for reaction in robot.reactions:
            force = readable_values(list(reaction.force), "N")
            _add_row(reactions, result.name, reaction.name, force)
    return [table for table in tables if table.row_count]


def _cell(own: EffectorRecord, values: Float[HostArray, " k"]) -> str:
    if np.isnan(values).any():
        return "-"
    return readable_values([_length(values)] if own.is_turn else list(values), own.unit)


def _outlook(assessment: Assessment) -> list[Any]:
    """Tabulate what the data tell about each parameter, and what they are blind to."""
    from rich.text import Text

    found = assessment.identifiability
    columns = ["std. error over asked", "verdict"]

    def style_of(verdict: str) -> str:
        # What the data would tell is no good news under a model that they contradict.
        doubtful = verdict == "identifiable" and not assessment.identified
        return "yellow" if doubtful else _STYLE[verdict]

    table = _start_table("What the data tell", "parameter", columns)
    for p in found.parameters:
        _add_row(table, p.name, percent(p.ratio), (p.verdict, style_of(p.verdict)))
    legend = f"{found.scale} {str(found.conditioning).splitlines()[0]}"
    style = style_of(found.verdict)
    return [table, Text(legend), Text(_blindness(assessment), style=style)]


def _blindness(assessment: Assessment) -> str:
    """Describe the directions of the parameters that the data hardly see."""
    found = assessment.identifiability
    blind = found.blind[::-1]
    if not blind:
        if found.verdict == "not identifiable":
            return "The data do not determine all parameters."
        if found.verdict != "identifiable":
            return "The data determine the parameters only weakly in part."
        if not assessment.identified:
            return (
                "The data would determine the parameters well; see the reasons below."
            )
        return "The data determine the parameters well."
    n, prior = found.n_parameters, "the prior and " if found.has_prior else ""
    several = "s" if n > 1 else ""
    lines = [
        f"The data hardly see {len(blind)} of {n} direction{several}; "
        f"along these {prior}the start decide{'' if prior else 's'}, not the data:"
    ]
    lines += [f"  {d.words} ({percent(d.ratio)})" for d in blind[:MOST_DIRECTIONS]]
    if len(blind) > MOST_DIRECTIONS:
        lines.append(f"  and {len(blind) - MOST_DIRECTIONS} more.")
    if found.has_prior:
        lines.append(f"They tell more than the prior along {found.informed} of {n}.")
    return "\n".join(lines)


def _start_table(title: str, first: str, columns: Sequence[str]) -> "rich.table.Table":
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold")
    table.add_column(first)
    for column in columns:
        table.add_column(column, justify="left" if column in _WORDS else "right")
    return table


def _add_row(table: "rich.table.Table", *cells: str | tuple[str, str]) -> None:
    """Add a row of texts to a table, some with a style: (text, style)."""
    from rich.text import Text

    pairs = [(cell, "") if isinstance(cell, str) else cell for cell in cells]
    # Text, not str, which would read a name like "[a]" as markup.
    table.add_row(*(Text(text, style=style) for text, style in pairs))


def _length(vector: Float[HostArray, "3"]) -> float:
    return float(np.linalg.norm(vector))


def _angle(radians: float) -> str:
    return "-" if math.isnan(radians) else f"{math.degrees(radians):.2f} deg"


def _distance(metres: float) -> str:
    return "-" if math.isnan(metres) else f"{1e3 * metres:.2f} mm"
