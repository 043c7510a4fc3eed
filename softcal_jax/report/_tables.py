"""Tables of what robots do, and of results for a terminal, printed by `rich`."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from softcal_jax._text_table import Cell, TextTable, Tone, text_table
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import ConfigurationResult, SimulationResult
from softcal_jax.configurations import EffectorRecord
from softcal_jax.equilibrium import ActuatorState
from softcal_jax.export import readable_values

if TYPE_CHECKING:
    import rich.console

HEADS: dict[Tone, str] = {
    "good": "bold green",
    "doubtful": "bold yellow",
    "bad": "bold white on red",
}
"""Styles of a verdict."""


def simulation_table(result: SimulationResult) -> "rich.console.Group":
    """Tabulate a forward simulation for the terminal: outcomes, then the robot."""
    from rich.console import Group

    return Group(*map(TextTable.drawn, simulation_tables(result)))


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


def robot_tables(configurations: Sequence[ConfigurationResult]) -> list[TextTable]:
    """Tabulate other effectors, actuators, bodies and reactions where there are any."""
    fitted = any(result.role != "simulation" for result in configurations)
    values = ["measured", "before", "after"] if fitted else ["simulated"]
    titles = {
        "Other effectors": ["effector", *values],
        "Actuators": ["actuator", "force or pressure", "displacement or growth"],
        "Rigid bodies": ["rigid body", "state", "moved by", "turned by"],
        "Reactions": ["of", "force of the ground (x, y, z)"],
    }
    rows: dict[str, list[tuple[str, ...]]] = {title: [] for title in titles}
    for result in configurations:
        for own in result.others:
            if own.is_turn and fitted:
                continue  # another table shows the errors of turns
            name = f"{own.name}{' (turn)' if own.is_turn else ''}"
            found = [own.measured, own.simulated_before, own.simulated][-len(values) :]
            shown = [_values(own, value) for value in found]
            rows["Other effectors"].append((result.name, name, *shown))
        robot = result.robot
        if robot is None:
            continue
        for own in robot.actuators:
            rows["Actuators"].append((result.name, own.name, *actuator_row(own)))
        for body in robot.bodies:
            moved = readable_values([_length(body.translation)], "m")
            turned = readable_values([_length(body.rotation_vector)], "rad")
            own_row = (result.name, body.name, body.state, moved, turned)
            rows["Rigid bodies"].append(own_row)
        for reaction in robot.reactions:
            force = readable_values(list(reaction.force), "N")
            rows["Reactions"].append((result.name, reaction.name, force))
    return [
        text_table(title, ("configuration", *columns), rows[title])
        for title, columns in titles.items()
        if rows[title]
    ]


def actuator_values(own: ActuatorState) -> dict[str, str]:
    """Write the force and the displacement of an actuator."""
    shown = {"force": readable_values([own.force], own.force_unit), "displacement": "-"}
    if own.displacement is not None and own.displacement_unit is not None:
        delta = readable_values([own.displacement], own.displacement_unit)
        shown["displacement"] = delta
    return shown


def actuator_row(own: ActuatorState) -> list[str]:
    """Write the force and the displacement of an actuator, and which is imposed."""
    shown = actuator_values(own)
    shown[own.imposed] += " (imposed)"
    return list(shown.values())


def _values(own: EffectorRecord, values: Float[HostArray, " k"]) -> str:
    if np.isnan(values).any():
        return "-"
    return readable_values([_length(values)] if own.is_turn else list(values), own.unit)


def _length(vector: Float[HostArray, "3"]) -> float:
    return float(np.linalg.norm(vector))


def distance(metres: float) -> str:
    """Write a distance in millimetres."""
    return "-" if math.isnan(metres) else f"{1e3 * metres:.2f} mm"
