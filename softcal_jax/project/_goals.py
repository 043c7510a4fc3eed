"""Goals and limits of inverse control as texts, in the words of a project file."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress
from typing import Any

import numpy as np

from softcal_jax._names import check_known, listed
from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import AbstractEffector, Configuration, ImposedForce
from softcal_jax.control import Limits
from softcal_jax.project._effectors import build_effectors
from softcal_jax.project._mechanism import ActuatorTable
from softcal_jax.project._problems import known_name, under
from softcal_jax.project._project import Project
from softcal_jax.project._quantities import LENGTH, parse_vector
from softcal_jax.project._reading import ProjectTable, read_tables
from softcal_jax.project._sensors import WrittenPoseTable

FREE = "-"
"""Stands for a coordinate of a marker without a goal: "(-, -, 3) mm"."""


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
    posed = _with_goals(project, table, configuration, goals)
    actuation: dict[str, Any] = {**posed.actuation}
    for name, text in starts.items():
        with under(f"start of {name!r}"):
            known_name("actuator", name, table.actuators, "[actuators]")
            actuation[name] = table.actuators[name].imposed(text)
    ranges: dict[str, Limits] = {}
    for name, text in limits:
        with under(f"limit of {name!r}"):
            known_name("actuator", name, table.actuators, "[actuators]")
            limited = _limited(table.actuators[name], text)
        ranges[name] = replace(ranges.get(name, Limits()), **limited)
    return replace(posed, actuation=actuation), ranges


def _with_goals(
    project: Project,
    table: ProjectTable,
    configuration: Configuration,
    goals: Mapping[str, str],
) -> Configuration:
    model, markers = project.model, configuration.markers
    effectors = build_effectors(table.effectors, model.mesh, model.mechanism)
    known = [*effectors, *(() if markers is None else markers.names)]
    aimed: list[AbstractEffector] = []
    places: dict[str, Float[HostArray, 3]] = {}
    for name, text in goals.items():
        check_known("marker or effector with a goal", known, name)
        with under(f"goal of {name!r}"):
            if name not in effectors:
                places[name] = _place(text)
                continue
            kind, value = table.effectors[name], _value(text)
            folder = project.path.parent
            aimed.append(kind.measured(effectors[name], value, folder, model))
    return replace(_with_markers(configuration, places), effectors=tuple(aimed))


def _limited(actuator: ActuatorTable, text: str) -> dict[str, tuple[float, float]]:
    """Parse limits; their unit says whether they are of force or displacement."""
    ends = re.split(r"\s+to\s+", text.strip())
    if len(ends) != 2:
        raise ValueError(f'got {text!r}; expected lowest to highest: "0 N to 5 N".')
    low, high = map(actuator.imposed, ends)
    if type(low) is not type(high):
        raise ValueError(
            f"{ends[0]!r} and {ends[1]!r} are of different kinds; expected both in "
            "units of its force, or of its displacement."
        )
    key = "force" if isinstance(low, ImposedForce) else "displacement"
    return {key: (low.value, high.value)}


def _value(text: str) -> Any:
    """Parse the goal of an effector: a quantity, or a pose as an inline table."""
    if not text.lstrip().startswith("{"):
        return text
    try:
        table = tomllib.loads(f"goal = {text}")["goal"]
    except tomllib.TOMLDecodeError as error:
        raise ValueError(
            f"got {text}, which is no inline table ({error}); expected a pose, like "
            '{ position = "(0, 0, 100) mm", azimuth = "10 deg" }.'
        ) from error
    return WrittenPoseTable.model_validate(table)


def _place(text: str) -> Float[HostArray, "3"]:
    """Parse the goal of a marker; NaN for coordinates that are left free."""
    coordinates = text.partition("(")[2].partition(")")[0].split(",")
    free = [coordinate.strip() == FREE for coordinate in coordinates]
    filled = re.sub(rf"(?<=[(,])\s*{FREE}\s*(?=[,)])", "0", text)
    place = np.array(parse_vector(filled, LENGTH))
    if all(free):
        raise ValueError(f"got {text!r}, which leaves every coordinate free.")
    return np.where(free, np.nan, place)


def _with_markers(
    configuration: Configuration, places: Mapping[str, Float[HostArray, "3"]]
) -> Configuration:
    """Keep the markers with a goal, and the axes along which they have one."""
    markers = configuration.markers
    if markers is None or not places:
        return replace(configuration, markers=None, measured=None)
    goals = np.array([*places.values()])
    asked = ~np.isnan(goals)
    if (asked != asked[0]).any():
        raise ValueError(
            f"the goals of {listed([repr(name) for name in places])} leave different "
            "coordinates free; expected the same of all markers."
        )
    rows = [markers.names.index(name) for name in places]
    std, rest = np.asarray(markers.std), markers.positions[rows]
    kept = replace(
        markers,
        names=tuple(places),
        positions=rest,
        std=markers.std if std.ndim == 0 else std[rows],
        axes="".join(compress("xyz", asked[0])),
    )
    return replace(configuration, markers=kept, measured=np.where(asked, goals, rest))
