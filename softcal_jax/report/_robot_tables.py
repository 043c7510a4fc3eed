"""Actuators, rigid bodies, reactions and effectors as tables for a terminal."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal_jax.export import readable_values
from softcal_jax.report._cells import plain_text, start_table

if TYPE_CHECKING:
    import rich.table

Entries = Sequence[Mapping[str, Any]]


def robot_tables(entries: Entries) -> list["rich.table.Table"]:
    """What actuators, rigid bodies and the ground do; nothing for a body without them.

    Args:
        entries: Configurations of `result_dict` or `simulation_dict`.
    """
    robots = [(e["name"], e["robot"]) for e in entries if e["robot"] is not None]
    makers = (_actuator_table, _body_table, _reaction_table)
    return [table for make in makers if (table := make(robots)).row_count]


def _actuator_table(robots) -> "rich.table.Table":
    table = start_table(
        "Actuators", "configuration", ["actuator", "force", "displacement"]
    )
    for name, robot in robots:
        for own in robot["actuators"]:
            shown = [
                "-"
                if own[key] is None
                else readable_values([own[key]], own[f"{key}_unit"])
                for key in ("force", "displacement")
            ]
            imposed = own["imposed"] == "displacement"
            shown[imposed] += " (imposed)"
            table.add_row(
                plain_text(name), plain_text(own["name"]), *map(plain_text, shown)
            )
    return table


def _body_table(robots) -> "rich.table.Table":
    columns = ["rigid body", "state", "moved by", "turned by"]
    table = start_table("Rigid bodies", "configuration", columns)
    for name, robot in robots:
        for body in robot["rigid_bodies"]:
            moved = 1e-3 * np.linalg.norm(body["translation_mm"])
            turned = np.linalg.norm(body["rotation_vector"])
            cells = (name, body["name"], body["state"])
            table.add_row(
                *map(plain_text, cells),
                plain_text(readable_values([float(moved)], "m")),
                plain_text(readable_values([float(turned)], "rad")),
            )
    return table


def _reaction_table(robots) -> "rich.table.Table":
    columns = ["of", "force of the ground (x, y, z)"]
    table = start_table("Reactions", "configuration", columns)
    for name, robot in robots:
        for reaction in robot["reactions"]:
            table.add_row(
                plain_text(name),
                plain_text(reaction["name"]),
                plain_text(readable_values(reaction["force"], "N")),
            )
    return table


def effector_table(entries: Entries) -> list["rich.table.Table"]:
    """Effectors that are no points: measured, before and after, or simulated.

    Args:
        entries: Configurations of `result_dict` or `simulation_dict`.

    Returns:
        One table, or none where there are no such effectors.
    """
    keys = {
        "measured": "measured",
        "simulated_before": "before",
        "simulated": "after",
    }
    fitted = any("measured" in e for entry in entries for e in entry["effectors"])
    if not fitted:
        keys = {"simulated": "simulated"}
    table = start_table(
        "Other effectors", "configuration", ["effector", *keys.values()]
    )
    for entry in entries:
        for own in entry["effectors"]:
            if own["is_turn"] and fitted:
                continue  # they have a table of their own, since errors are what counts
            table.add_row(
                plain_text(entry["name"]),
                plain_text(f"{own['name']}{' (turn)' if own['is_turn'] else ''}"),
                *(plain_text(_cell(own, key)) for key in keys),
            )
    return [table] if table.row_count else []


def _cell(own: Mapping[str, Any], key: str) -> str:
    values = own[key]
    if values is None or any(v is None for v in values):
        return "-"
    values = [math.hypot(*values)] if own["is_turn"] else values
    return readable_values(values, own["unit"])
