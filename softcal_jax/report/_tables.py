"""Results as tables for a terminal, printed by `rich`."""

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
    parts: list[Any] = [_parameter_table(result, found), _configuration_table(result)]
    parts += [*_outlook(found), head]
    if result.starts is not None:
        parts.append(Text(str(result.starts)))
    parts += [Text(f"Note: {note}", style="yellow") for note in result.notes]
    return Group(*parts)


def simulation_table(data: Mapping[str, Any]) -> "rich.table.Table":
    """A forward simulation as a table for the terminal, to be printed by `rich`.

    Args:
        data: What `simulation_dict` returns.

    Returns:
        One line per configuration; one without an equilibrium gives the reason.
    """
    table = _table(
        "Simulation", "configuration", ["largest displacement", "Newton steps"]
    )
    table.add_column("outcome")
    for entry in data["configurations"]:
        largest = entry["largest_displacement_mm"]
        table.add_row(
            _plain(entry["name"]),
            _plain("-" if largest is None else f"{largest:.2f} mm"),
            _plain(str(entry["newton_steps"])),
            _plain(entry["outcome"], "green" if entry["converged"] else "bold red"),
        )
    return table


def _parameter_table(
    result: CalibrationResult, found: Identifiability
) -> "rich.table.Table":
    blind = {p.name for p in found.parameters if p.verdict == "not identifiable"}
    table = _table("Parameters", "parameter", ["value ± std. error", "start", "bounds"])
    for q in result.parameters:
        text = readable_estimate(q.value, q.standard_error, q.unit)
        if q.at_bound:
            text += " (on a bound)"
        factor, unit = readable_unit([q.value], q.unit)
        bounds = f"{q.lower * factor:.4g} to {q.upper * factor:.4g} {unit}"
        sound = result.converged and not q.at_bound and q.name not in blind
        style = "bold" if sound else "bold red"
        table.add_row(
            _plain(q.name),
            _plain(text, style),
            _plain(f"{q.start * factor:.4g} {unit}".rstrip()),
            _plain(bounds.rstrip()),
        )
    return table


def _configuration_table(result: CalibrationResult) -> "rich.table.Table":
    table = _table(
        "Rms distance of the markers",
        "configuration",
        ["role", "before", "after", "moved", "after/moved"],
    )
    for entry in result_dict(result)["configurations"]:
        percent = entry["rms_after_percent_of_motion"]
        table.add_row(
            _plain(entry["name"]),
            _plain(entry["role"]),
            _plain(_distance(entry["rms_before_mm"])),
            _plain(_distance(entry["rms_after_mm"]), "bold"),
            _plain(f"{entry['motion_mm']:.2f} mm"),
            _plain("-" if percent is None else f"{percent:.1f} %"),
        )
    return table


def _outlook(found: Identifiability) -> list[Any]:
    """What the data tell about each parameter, and what they are blind to."""
    from rich.text import Text

    table = _table("What the data tell", "parameter", ["spread left"])
    table.add_column("verdict")
    for p in found.parameters:
        table.add_row(
            _plain(p.name),
            _plain(_percent(p.spread)),
            _plain(p.verdict, _STYLE[p.verdict]),
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


def _distance(millimetres: float | None) -> str:
    return "-" if millimetres is None else f"{millimetres:.2f} mm"


def _table(title: str, first: str, columns: Sequence[str]) -> "rich.table.Table":
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold")
    table.add_column(first)
    for column in columns:
        table.add_column(column, justify="left" if column == "role" else "right")
    return table


def _plain(text: str, style: str = "") -> Any:
    """Text as it stands: a name like "[a]" is no markup."""
    from rich.text import Text

    return Text(text, style=style)
