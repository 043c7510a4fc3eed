"""The project of a robot that is printed as it was designed."""

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax._units import readable
from softcal_jax.configurations import ImposedDisplacement
from softcal_jax.designs import DesignResult, Printing
from softcal_jax.fields import ControlPointParameters, Entry, Parameter
from softcal_jax.project._project import Project
from softcal_jax.project._reading import Keys, read_toml, with_changes

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
    tables = raw.get("parameters", [])
    entries = () if project.space is None else project.space.entries
    # Those of [[setup]] come after them, and are not known any better by a design.
    for table, entry in zip(tables, entries[: len(tables)], strict=True):
        table |= _known(entry, result, project.asked.printing)
    actuators = project.model.mechanism.actuators
    commanded = {c.name: c.actuation for c in result.configurations}
    raw.get("shared", {}).pop("goal", None)
    for table in raw["configurations"]:
        table.pop("goal", None)
        texts: dict[str, Any] = {}
        for name in project.asked.limits:
            imposed = commanded.get(table["name"], {}).get(name)
            if imposed is None:
                continue
            kind = actuators.kinds[actuators.names.index(name)]
            by_displacement = isinstance(imposed, ImposedDisplacement)
            unit = kind.displacement_unit if by_displacement else kind.force_unit
            texts[name] = f"{float(imposed.value)!r} {unit}"
            if imposed.releasing:
                texts[name] = {"value": texts[name], "releasing": True}
        if texts:
            table["actuation"] = table.get("actuation", {}) | texts
    return _HEAD + _document(raw)


def _moved(value: Any, way: Path, keys: Keys = ()) -> Any:
    """Name files as they are found from another folder; `way` leads to the old one."""
    if isinstance(value, list):
        return [_moved(inner, way, (*keys, i)) for i, inner in enumerate(value)]
    if isinstance(value, dict):
        return {k: _moved(inner, way, (*keys, k)) for k, inner in value.items()}
    named = isinstance(value, str) and _is_file(keys)
    return (way / value).as_posix() if named else value


def _is_file(keys: Keys) -> bool:
    """Say whether files stand at a key; a marker may be called "file", too."""
    match keys:
        case ("mesh", "file") | ("bodies", _, "shape", "file"):
            return True
        case ("shared", "measured", *of) | (_, int(), "measured", *of):
            match of:
                case ["file"] | ["effectors", _, "file" | "photos" | "board", *_]:
                    return True
                case ["effectors", _, "displacement_from", "photos", *_]:
                    return True
    return False


def _known(entry: Entry, result: DesignResult, printing: Printing) -> dict[str, Any]:
    """Return start and prior of a parameter, as keys of its table."""
    assert isinstance(entry, Parameter | ControlPointParameters)
    # In full digits of SI: a value on its bound stays on it.
    starts: dict[str, Any] = {}
    for q in entry.parameters:
        value = float(np.clip(result.values[q.name], float(q.lower), float(q.upper)))
        starts[q.name] = f"{value!r} {entry.unit}" if entry.unit else value
    known: dict[str, Any] = {"start": next(iter(starts.values()))}
    if isinstance(entry, ControlPointParameters):
        names = {p: entry.parameter_name(p) for p in entry.control_points.names}
        known["start"] = {p: starts[n] for p, n in names.items() if n in starts}
    if entry.unit == "rad":
        known["prior_std"] = readable(printing.angle, "rad")
    elif entry.unit == "Pa":
        linear = printing.moduli * max(result.values[name] for name in starts)
        log = entry.scale == "log"
        known["prior_std"] = printing.moduli if log else readable(linear, "Pa")
    return known


def _document(raw: dict[str, Any]) -> str:
    """Write a document of TOML; tables below the first level stand in one line."""
    is_table = lambda value: isinstance(value, dict)
    is_list = lambda v: isinstance(v, list) and v != [] and all(map(is_table, v))
    lines = [
        f"{toml_key(key)} = {toml_value(value)}"
        for key, value in raw.items()
        if not (is_table(value) or is_list(value))
    ]
    for key, value in raw.items():
        tables = value if is_list(value) else [value] if is_table(value) else []
        head = f"[[{toml_key(key)}]]" if is_list(value) else f"[{toml_key(key)}]"
        for table in tables:
            lines += ["", head]
            lines += [f"{toml_key(k)} = {toml_value(v)}" for k, v in table.items()]
    return "\n".join(lines) + "\n"


def toml_key(key: str) -> str:
    """Write a key as TOML has it, in quotes where it needs them."""
    return key if re.fullmatch(r"[\w-]+", key, re.ASCII) else toml_value(key)


def toml_value(value: Any) -> str:
    """Write a value as TOML has it, in one line; texts are escaped as in JSON."""
    if isinstance(value, dict):
        pairs = ", ".join(f"{toml_key(k)} = {toml_value(v)}" for k, v in value.items())
        return f"{{ {pairs} }}" if pairs else "{}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False)
