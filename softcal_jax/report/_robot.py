"""What a robot does in its configurations, in tables."""

from collections.abc import Sequence

import numpy as np

from softcal_jax._text_table import TextTable, text_table
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.configurations import EffectorRecord
from softcal_jax.equilibrium import ActuatorState
from softcal_jax.export import readable_values


def robot_tables(configurations: Sequence[ConfigurationResult]) -> list[TextTable]:
    """Tabulate effectors that are not points, actuators, rigid bodies and reactions.

    There is no table for what is missing.
    """
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
        rows["Actuators"] += [(result.name, *actuator_row(a)) for a in robot.actuators]
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


def actuator_row(own: ActuatorState) -> tuple[str, ...]:
    """Write name, force and displacement of an actuator, and which is imposed."""
    shown = [readable_values([own.force], own.force_unit), "-"]
    if own.displacement is not None and own.displacement_unit is not None:
        shown[1] = readable_values([own.displacement], own.displacement_unit)
    shown[own.imposed == "displacement"] += " (imposed)"
    return own.name, *shown


def _values(own: EffectorRecord, values: Float[HostArray, " k"]) -> str:
    if np.isnan(values).any():
        return "-"
    return readable_values([_length(values)] if own.is_turn else list(values), own.unit)


def _length(vector: Float[HostArray, "3"]) -> float:
    return float(np.linalg.norm(vector))
