"""Tables of actuators, rigid bodies, reactions and effectors for a terminal."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.configurations import EffectorRecord
from softcal_jax.export import readable_values
from softcal_jax.report._cells import add_row, start_table

if TYPE_CHECKING:
    import rich.table

Configurations = Sequence[ConfigurationResult]


def robot_tables(configurations: Configurations) -> list["rich.table.Table"]:
    """Tabulate actuators, rigid bodies and reactions; no table for what is missing.

    Args:
        configurations: Those of a calibration or a simulation.
    """
    actuators = start_table(
        "Actuators", "configuration", ["actuator", "force", "displacement"]
    )
    columns = ["rigid body", "state", "moved by", "turned by"]
    bodies = start_table("Rigid bodies", "configuration", columns)
    columns = ["of", "force of the ground (x, y, z)"]
    reactions = start_table("Reactions", "configuration", columns)
    for result in configurations:
        robot = result.robot
        if robot is None:
            continue
        for own in robot.actuators:
            shown = [readable_values([own.force], own.force_unit), "-"]
            if own.displacement is not None and own.displacement_unit is not None:
                shown[1] = readable_values([own.displacement], own.displacement_unit)
            shown[own.imposed == "displacement"] += " (imposed)"
            add_row(actuators, result.name, own.name, *shown)
        for body in robot.bodies:
            moved = readable_values([_length(body.translation)], "m")
            turned = readable_values([_length(body.rotation_vector)], "rad")
            add_row(bodies, result.name, body.name, body.state, moved, turned)
        for reaction in robot.reactions:
            force = readable_values(list(reaction.force), "N")
            add_row(reactions, result.name, reaction.name, force)
    return [table for table in (actuators, bodies, reactions) if table.row_count]


def effector_table(configurations: Configurations) -> list["rich.table.Table"]:
    """Tabulate effectors that are not points: measured, before, after, or simulated.

    Args:
        configurations: Those of a calibration or a simulation.

    Returns:
        One table, or none if there are no such effectors.
    """
    fitted = any(result.role != "simulation" for result in configurations)
    columns = ["measured", "before", "after"] if fitted else ["simulated"]
    table = start_table("Other effectors", "configuration", ["effector", *columns])
    for result in configurations:
        for own in result.others:
            if own.is_turn and fitted:
                continue  # another table shows the errors of turns
            values = [own.measured, own.simulated_before, own.simulated]
            cells = [_cell(own, value) for value in values[-len(columns) :]]
            name = f"{own.name}{' (turn)' if own.is_turn else ''}"
            add_row(table, result.name, name, *cells)
    return [table] if table.row_count else []


def _cell(own: EffectorRecord, values: Float[HostArray, " k"]) -> str:
    if np.isnan(values).any():
        return "-"
    return readable_values([_length(values)] if own.is_turn else list(values), own.unit)


def _length(vector: Float[HostArray, "3"]) -> float:
    return float(np.linalg.norm(vector))
