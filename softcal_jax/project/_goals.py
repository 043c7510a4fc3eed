"""Goals of inverse control as texts, and the project of a robot as it was designed."""

import json
import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax._units import readable
from softcal_jax.configurations import Configuration, ImposedDisplacement
from softcal_jax.control import Limits
from softcal_jax.designs import DesignResult, Printing
from softcal_jax.fields import ControlPointParameters, Entry, Parameter
from softcal_jax.project._design import limited, with_goals
from softcal_jax.project._project import Project
from softcal_jax.project._reading import Keys, read_tables, read_toml, with_changes
from softcal_jax.project._robot import imposed_on
from softcal_jax.project._table import under


def inverse_as_typed(
    project: Project,
    configuration: Configuration,
    *,
    goals: Mapping[str, str],
    starts: Mapping[str, str],
    limits: Sequence[tuple[str, str]],
) -> tuple[Configuration, dict[str, Limits]]:
    """Read what inverse control is asked for, in the words of a project file.

    Args:
        project: The project.
        configuration: One of its configurations; what it measures is no goal.
        goals: Goals by the names of markers and effectors, as `measured` of a project
            file has them: "(100, 10, 12) mm", "4 mm", "20 deg", or a pose,
            '{ position = "(100, 10, 12) mm", azimuth = "10 deg" }'. A marker may leave
            coordinates free, "(-, -, 12) mm".
        starts: What is imposed on actuators at first: "20 kPa" or "2 ml".
        limits: Actuators and their limits, like ("air", "0 kPa to 50 kPa"). The unit
            tells whether force or displacement is limited; an actuator may have both.

    Returns:
        The configuration with these goals and no others, and with the actuators of
        `starts` commanded as well; and the limits by actuator.

    Raises:
        ValueError: If a name is unknown, a value is not of the actuator or effector, or
            markers leave different coordinates free; the text says what was expected.
    """
    table = read_tables(project.path, project.source.changes)
    values = {}
    for name, text in goals.items():
        with under(f"goal of {name!r}"):
            values[name] = _value(text)
    posed = with_goals(project.model, table, configuration, values)
    actuation: dict[str, Any] = {**posed.actuation}
    for name, text in starts.items():
        with under(f"start of {name!r}"):
            actuation[name] = imposed_on(table.actuators, name, text)
    ranges: dict[str, Limits] = {}
    for name, text in limits:
        with under(f"limit of {name!r}"):
            limits_of = limited(table.actuators, name, text)
        ranges[name] = replace(ranges.get(name, Limits()), **limits_of)
    return replace(posed, actuation=actuation), ranges


def _value(text: str) -> Any:
    """Parse a goal: a quantity, or a pose as an inline table."""
    if not text.lstrip().startswith("{"):
        return text
    try:
        raw = tomllib.loads(f"goal = {text}")
        if len(raw) > 1:
            raise ValueError("more stands after its end")
        return raw["goal"]
    except (ValueError, RecursionError) as error:
        raise ValueError(
            f"got {text}, which is no inline table ({error}); expected a pose, like "
            '{ position = "(0, 0, 100) mm", azimuth = "10 deg" }.'
        ) from error


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
