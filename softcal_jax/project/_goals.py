"""Goals and limits of inverse control as texts, in the words of a project file."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from softcal_jax.configurations import Configuration
from softcal_jax.control import Limits
from softcal_jax.project._design import limited, with_goals
from softcal_jax.project._mechanism import imposed_on
from softcal_jax.project._problems import known_name, under
from softcal_jax.project._project import Project
from softcal_jax.project._reading import read_tables


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
    folder, model = project.path.parent, project.model
    values = {}
    for name, text in goals.items():
        with under(f"goal of {name!r}"):
            values[name] = _value(text)
    posed = with_goals(folder, model, table, configuration, values)
    actuation: dict[str, Any] = {**posed.actuation}
    for name, text in starts.items():
        with under(f"start of {name!r}"):
            known_name("actuator", name, table.actuators, "[actuators]")
            actuation[name] = imposed_on(table.actuators[name].makes.kind, text)
    ranges: dict[str, Limits] = {}
    for name, text in limits:
        with under(f"limit of {name!r}"):
            known_name("actuator", name, table.actuators, "[actuators]")
            limits_of = limited(table.actuators[name].makes.kind, text)
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
