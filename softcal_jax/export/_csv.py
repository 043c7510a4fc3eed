"""CSV tables for a spreadsheet; missing values are empty cells."""

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from softcal_jax._text import as_cell
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.configurations import EffectorRecord
from softcal_jax.equilibrium import RobotState

_VALUES = ("measured", "simulated_before", "simulated", "residual")

Configurations = Sequence[ConfigurationResult]


def write_markers_csv(path: Path, configurations: Configurations) -> None:
    """Write one line per configuration and marker or other point of a calibration."""
    header = ["configuration", "role", "marker"]
    header += [f"{column}_{axis}_mm" for column in _VALUES for axis in "xyz"]
    rows = []
    for fit in configurations:
        for point in fit.points:
            values = np.concatenate(_values(point))
            error = point.error(point.simulated)
            distance = float(np.linalg.norm(error)) if point.seen.any() else math.nan
            shown = [_text(1e3 * v, ".6f") for v in (*values, distance)]
            rows.append([fit.name, fit.role, point.name, *shown])
    _write(path, [*header, "distance_mm"], rows)


def write_effectors_csv(path: Path, configurations: Configurations) -> None:
    """Write one line per coordinate of effectors that are not points, in SI."""
    rows = []
    for fit in configurations:
        for e in fit.others:
            what = "turn" if e.is_turn else "value"
            for axis, values in zip("xyz", np.transpose(_values(e)), strict=False):
                coordinate = f"{what}_{axis}" if len(e.measured) > 1 else what
                row = [fit.name, fit.role, e.name, coordinate, e.unit]
                rows.append([*row, *map(_text, values)])
    header = ["configuration", "role", "effector", "coordinate", "unit", *_VALUES]
    _write(path, header, rows)


def _values(effector: EffectorRecord) -> list[Float[HostArray, " k"]]:
    return [getattr(effector, column) for column in _VALUES]


def write_robot_csv(path: Path, configurations: Configurations) -> None:
    """Write a line per value of bodies, actuators, reactions and contacts, in SI."""
    header = ["configuration", "part", "name", "what", "quantity", "value", "unit"]
    rows = [
        [result.name, *words, _text(value), unit]
        for result in configurations
        if result.robot is not None
        for *words, value, unit in _robot_rows(result.robot)
    ]
    _write(path, header, rows)


def _robot_rows(robot: RobotState):
    """Yield part, name, kind, quantity, value and unit of each value."""
    units = {"position": "m", "translation": "m", "rotation_vector": "rad"}
    for body in robot.bodies:
        head = ("rigid body", body.name, body.state)
        for what, unit in units.items():
            for axis, value in zip("xyz", getattr(body, what), strict=True):
                yield *head, f"{what}_{axis}", value, unit
    for actuator in robot.actuators:
        head = ("actuator", actuator.name, actuator.kind)
        for what in ("force", "displacement"):
            value = getattr(actuator, what)
            if value is not None:
                suffix = " (imposed)" if actuator.imposed == what else ""
                yield *head, f"{what}{suffix}", value, getattr(actuator, f"{what}_unit")
    for reaction in robot.reactions:
        head = ("reaction", reaction.name, "force of the ground")
        for axis, value in zip("xyz", reaction.force, strict=True):
            yield *head, f"force_{axis}", value, "N"
    yield from _contact_rows(robot)


def _contact_rows(robot: RobotState):
    units = {"force": "N", "moment": "N m", "area": "m2", "depth": "m", "sliding": "-"}
    for contact in robot.contacts:
        head = ("contact", contact.name, "obstacle")
        for what, unit in units.items():
            values = np.atleast_1d(getattr(contact, what))
            axes = [f"_{axis}" for axis in "xyz"] if len(values) > 1 else [""]
            for axis, value in zip(axes, values.tolist(), strict=True):
                yield *head, f"{what}{axis}", value, unit


def _text(value: float, digits: str = ".9g") -> str:
    return f"{value:{digits}}" if math.isfinite(value) else ""


def _write(path: Path, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        lines = ([as_cell(cell) for cell in line] for line in (header, *rows))
        csv.writer(file, lineterminator="\n").writerows(lines)
