"""The project of a robot that is printed as it was designed."""

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax.configurations import ImposedDisplacement
from softcal_jax.designs import DesignResult, Printing
from softcal_jax.fields import ControlPointParameters, Entry, Parameter
from softcal_jax.project._project import Project
from softcal_jax.project._reading import read_toml, with_changes

_FILES = "file", "photos", "board"
"""Keys whose values are files."""

_HEAD = """\
# The robot as it was designed. Print it, measure some poses, and give each of them
# `measured`, as in a calibration: it starts from the design, with errors of printing
# as priors.

"""


def printed_project(project: Project, result: DesignResult, folder: Path) -> str:
    """Write the project file of a printed design, that is to stand in a folder.

    It has the configurations of the goals with the actuation that was found, and the
    parameters begin at their designed values, with the errors of printing as priors.
    """
    raw = read_toml(project.path, "project file")
    raw = with_changes(project.path, raw, project.source.changes)
    raw.pop("design", None)
    here, there = project.path.parent.resolve(), folder.resolve()
    raw = _moved(raw, Path(os.path.relpath(here, there)))
    entries = () if project.space is None else project.space.entries
    for table, entry in zip(raw.get("parameters", ()), entries, strict=False):
        table |= _known(entry, result, project.asked.printing)
    actuators = project.model.mechanism.actuators
    commanded = {c.name: c.actuation for c in result.configurations}
    for table in raw["configurations"]:
        if table.pop("goal", None) is None:
            continue
        texts = {}
        for name in project.asked.limits:
            imposed = commanded[table["name"]].get(name)
            if imposed is None:
                continue
            kind = actuators.kinds[actuators.names.index(name)]
            by_displacement = isinstance(imposed, ImposedDisplacement)
            unit = kind.displacement_unit if by_displacement else kind.force_unit
            texts[name] = f"{imposed.value:.9g} {unit}"
        if texts:
            table["actuation"] = table.get("actuation", {}) | texts
    return _HEAD + _document(raw)


def _moved(value: Any, way: Path, *, is_file: bool = False) -> Any:
    """Name files as they are found from another folder; `way` leads to the old one."""
    if isinstance(value, list):
        return [_moved(inner, way, is_file=is_file) for inner in value]
    if isinstance(value, dict):
        return {
            k: _moved(inner, way, is_file=k in _FILES) for k, inner in value.items()
        }
    return (way / value).as_posix() if is_file and isinstance(value, str) else value


def _known(entry: Entry, result: DesignResult, printing: Printing) -> dict[str, Any]:
    """Return start and prior of a parameter, as keys of its table."""
    assert isinstance(entry, Parameter | ControlPointParameters)
    unit, factor = ("deg", 180.0 / np.pi) if entry.unit == "rad" else (entry.unit, 1.0)
    shown = lambda value: f"{factor * value:.9g} {unit}" if unit else float(value)
    known: dict[str, Any] = {"start": shown(result.values[entry.parameters[0].name])}
    if isinstance(entry, ControlPointParameters):
        names = entry.control_points.names
        free = {point: entry.parameter_name(point) for point in names}
        values = {p: result.values[n] for p, n in free.items() if n in result.values}
        known["start"] = {p: shown(value) for p, value in values.items()}
    if entry.unit == "rad":
        known["prior_std"] = shown(printing.angle)
    elif entry.unit == "Pa":
        sizes = [result.values[q.name] for q in entry.parameters]
        linear = shown(printing.moduli * max(sizes))
        known["prior_std"] = printing.moduli if entry.scale == "log" else linear
    return known


def _document(raw: dict[str, Any]) -> str:
    """Write a document of TOML; tables below the first level stand in one line."""
    is_table = lambda value: isinstance(value, dict)
    is_list = lambda value: isinstance(value, list) and value and is_table(value[0])
    lines = [
        f"{_key(key)} = {_value(value)}"
        for key, value in raw.items()
        if not (is_table(value) or is_list(value))
    ]
    for key, value in raw.items():
        tables = value if is_list(value) else [value] if is_table(value) else []
        head = f"[[{_key(key)}]]" if is_list(value) else f"[{_key(key)}]"
        for table in tables:
            lines += ["", head]
            lines += [f"{_key(k)} = {_value(v)}" for k, v in table.items()]
    return "\n".join(lines) + "\n"


def _key(key: str) -> str:
    return key if re.fullmatch(r"[\w-]+", key, re.ASCII) else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, dict):
        pairs = ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items())
        return f"{{ {pairs} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    return repr(value) if isinstance(value, float) else json.dumps(value)
