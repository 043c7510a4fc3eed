"""CSV tables for a spreadsheet; missing values are empty cells."""

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax._text import as_cell
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.configurations import EffectorRecord

_VALUES = ("measured", "simulated_before", "simulated", "residual")
_PLACE = {"position": "m", "translation": "m", "rotation_vector": "rad"}
_FELT = {"force": "N", "moment": "N m", "area": "m2", "depth": "m", "sliding": "-"}
"""Attributes of bodies and of contacts that are written, and their units."""


def write_csv(folder: Path, configurations: Sequence[ConfigurationResult]) -> list[str]:
    """Write the values of all configurations; return the names of the files.

    A line of `markers.csv` is a marker or other point, in mm; one of `effectors.csv` a
    coordinate of an effector that is not a point, in SI; one of `robot.csv` a value of
    a body, actuator, reaction or contact, in SI. A file without lines is left out.
    """
    pose = ["configuration", "role"]
    places = [f"{column}_{axis}_mm" for column in _VALUES for axis in "xyz"]
    state = ["configuration", "part", "name", "what", "quantity", "value", "unit"]
    tables = {
        "markers.csv": ([*pose, "marker", *places, "distance_mm"], _markers),
        "effectors.csv": ([*pose, "effector", "coordinate", "unit", *_VALUES], _others),
        "robot.csv": (state, _robot),
    }
    files = []
    for name, (header, lines_of) in tables.items():
        lines = [line for result in configurations for line in lines_of(result)]
        if lines:
            files.append(name)
            cells = ([as_cell(cell) for cell in line] for line in (header, *lines))
            with (folder / name).open("w", newline="", encoding="utf-8") as file:
                csv.writer(file, lineterminator="\n").writerows(cells)
    return files


def _markers(fit: ConfigurationResult) -> Iterator[list[str]]:
    for point in fit.points:
        values = np.concatenate(_values(point))
        lengths = *values, point.distance(point.simulated)
        shown = [_text(1e3 * v, ".6f") for v in lengths]
        yield [fit.name, fit.role, point.name, *shown]


def _others(fit: ConfigurationResult) -> Iterator[list[str]]:
    for e in fit.others:
        what = "turn" if e.is_turn else "value"
        for axis, values in zip("xyz", np.transpose(_values(e)), strict=False):
            coordinate = f"{what}_{axis}" if len(e.measured) > 1 else what
            head = [fit.name, fit.role, e.name, coordinate, e.unit]
            yield [*head, *map(_text, values)]


def _values(effector: EffectorRecord) -> list[Float[HostArray, " k"]]:
    return [getattr(effector, column) for column in _VALUES]


def _robot(result: ConfigurationResult) -> Iterator[list[str]]:
    robot = result.robot
    if robot is None:
        return
    for body in robot.bodies:
        head = [result.name, "rigid body", body.name, body.state]
        yield from _components(head, body, _PLACE)
    for actuator in robot.actuators:
        head = [result.name, "actuator", actuator.name, actuator.kind]
        for what in ("force", "displacement"):
            value, unit = getattr(actuator, what), getattr(actuator, f"{what}_unit")
            if value is not None:
                suffix = " (imposed)" if actuator.imposed == what else ""
                yield [*head, f"{what}{suffix}", _text(value), unit]
    for reaction in robot.reactions:
        head = [result.name, "reaction", reaction.name, "force of the ground"]
        yield from _components(head, reaction, {"force": "N"})
    for contact in robot.contacts:
        head = [result.name, "contact", contact.name, "obstacle"]
        yield from _components(head, contact, _FELT)


def _components(
    head: list[str], state: Any, units: Mapping[str, str]
) -> Iterator[list[str]]:
    for what, unit in units.items():
        values = np.atleast_1d(getattr(state, what)).tolist()
        names = [f"{what}_{axis}" for axis in "xyz"] if len(values) > 1 else [what]
        for name, value in zip(names, values, strict=True):
            yield [*head, name, _text(value), unit]


def _text(value: float, digits: str = ".9g") -> str:
    return f"{value:{digits}}" if math.isfinite(value) else ""
