"""Tables of what robots do, and of results for a terminal, printed by `rich`."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from softcal_jax._text_table import Cell, TextTable, Tone, or_dash, text_table
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
    for pose in result.configurations:
        largest = pose.largest_displacement if pose.converged else math.nan
        outcome = Cell(pose.outcome, "good" if pose.converged else "bad")
        rows.append((pose.name, distance(largest), str(pose.newton_steps), outcome))
    columns = "configuration", "largest displacement", "Newton steps", "outcome"
    table = text_table("Simulation", columns, rows)
    return [table, *robot_tables(result.configurations)]


def robot_tables(configurations: Sequence[ConfigurationResult]) -> list[TextTable]:
    """Tabulate actuators, rigid bodies, reactions, and effectors that are no points."""
    roles = {result.role for result in configurations}
    fitted = roles != {"simulation"}
    values = ["measured", "before", "after"] if fitted else ["simulated"]
    if "prediction" in roles:
        values = ["measured", "simulated"]
    titles = {
        "Other effectors": ["effector", *values],
        "Actuators": ["actuator", "force or pressure", "displacement or growth"],
        "Rigid bodies": ["rigid body", "state", "displacement", "rotation"],
        "Reactions": ["of", "force of the ground (x, y, z)"],
    }
    rows: dict[str, list[tuple[str, ...]]] = {title: [] for title in titles}
    for result in configurations:
        for effector in result.others:
            if effector.is_turn and fitted:
                continue  # another table shows the errors of turns
            name = f"{effector.name}{' (turn)' if effector.is_turn else ''}"
            vectors = {
                "measured": effector.measured,
                "before": effector.simulated_before,
            }
            of_value = (vectors.get(value, effector.simulated) for value in values)
            shown = [_values(effector, vector) for vector in of_value]
            rows["Other effectors"].append((result.name, name, *shown))
        robot = result.robot
        if robot is None:
            continue
        for state in robot.actuators:
            rows["Actuators"].append((result.name, state.name, *actuator_row(state)))
        for body in robot.bodies:
            moved = readable_values([_length(body.translation)], "m")
            turned = readable_values([_length(body.rotation_vector)], "rad")
            row = (result.name, body.name, body.state, moved, turned)
            rows["Rigid bodies"].append(row)
        for reaction in robot.reactions:
            force = readable_values(list(reaction.force), "N")
            rows["Reactions"].append((result.name, reaction.name, force))
    return [
        text_table(title, ("configuration", *columns), rows[title])
        for title, columns in titles.items()
        if rows[title]
    ]


def actuator_values(actuator: ActuatorState) -> dict[str, str]:
    """Write the force and the displacement of an actuator."""
    force = readable_values([actuator.force], actuator.force_unit)
    shown = {"force": force, "displacement": "-"}
    if actuator.displacement is not None and actuator.displacement_unit is not None:
        delta = readable_values([actuator.displacement], actuator.displacement_unit)
        shown["displacement"] = delta
    return shown


def actuator_row(actuator: ActuatorState) -> list[str]:
    """Write the force and the displacement of an actuator, and which is imposed."""
    shown = actuator_values(actuator)
    shown[actuator.imposed] += " (imposed)"
    return list(shown.values())


def _values(effector: EffectorRecord, values: Float[HostArray, " k"]) -> str:
    shown = [_length(values)] if effector.is_turn else list(values)
    return "-" if np.isnan(values).any() else readable_values(shown, effector.unit)


def _length(vector: Float[HostArray, "3"]) -> float:
    return float(np.linalg.norm(vector))


def distance(metres: float) -> str:
    """Write a distance in millimetres."""
    return or_dash(1e3 * metres, ".2f", "mm")
