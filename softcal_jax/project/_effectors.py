"""From the tables of a project file to effectors with what was measured of them."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from softcal_jax.configurations import (
    AbstractEffector,
    ActuatorDisplacement,
    ActuatorForce,
    BodyAngle,
    BodyFrame,
    Centroid,
    Mechanism,
    SupportReaction,
)
from softcal_jax.mesh import TetMesh
from softcal_jax.project._problems import at, known_name, shown
from softcal_jax.project._quantities import (
    ANGLE,
    FORCE,
    LENGTH,
    OF_UNIT,
    Dimension,
    parse_scalar,
    parse_vector,
)
from softcal_jax.project._readings import measured_motion
from softcal_jax.project._schema_effectors import EffectorTable, MeasuredPoseTable

Effectors = dict[str, AbstractEffector]


def build_effectors(
    path: Path,
    tables: Mapping[str, EffectorTable],
    mesh: TetMesh,
    mechanism: Mechanism,
) -> Effectors:
    """All effectors of a project, by name; nothing is measured yet.

    Raises:
        ProjectError: If one does not fit the mesh, the bodies or the actuators.
    """
    found: Effectors = {}
    for name, table in tables.items():
        with at(path, f"effectors.{name}"):
            _check_names(table, mechanism)
            dimension = _dimension(table, mechanism)
            found[name] = _effector(name, table, _std(path, name, table, dimension))
            found[name].rows(mesh, mechanism)
    return found


def with_measured(
    path: Path,
    key: str,
    effectors: Effectors,
    measured: Mapping[str, Any],
    tables: Mapping[str, EffectorTable],
    mechanism: Mechanism,
) -> tuple[AbstractEffector, ...]:
    """The effectors of a configuration, with its measurements.

    Args:
        path: The project file, for messages and as the base of relative paths.
        key: Key of the measurements in it.
        effectors: The effectors of the configuration.
        measured: What was measured, by their names.
        tables: Their tables.
        mechanism: Rigid bodies and actuators.

    Raises:
        ProjectError: If a name is unknown, or a value or file is wrong.
    """
    found = dict(effectors)
    for name, value in measured.items():
        with at(path, f"{key}.{name}"):
            known_name("effector", name, effectors, "effectors")
            own = _value(path.parent, tables[name], found[name], value, mechanism)
            found[name] = replace(found[name], measured=own)  # pyright: ignore
    return tuple(found.values())


def _check_names(table: EffectorTable, mechanism: Mechanism) -> None:
    bodies, actuators = mechanism.bodies.names, mechanism.actuators.names
    for key, kind, known, section in (
        ("body", "rigid body", bodies, "bodies"),
        ("other", "rigid body", bodies, "bodies"),
        ("actuator", "actuator", actuators, "actuators"),
    ):
        name = getattr(table, key)
        if name is not None:
            known_name(kind, name, known, section)


def _dimension(table: EffectorTable, mechanism: Mechanism) -> Dimension:
    """What `std` and the measured value of an effector measure."""
    if table.type in ("frame", "centroid"):
        return LENGTH
    if table.type == "angle":
        return ANGLE
    if table.type == "reaction":
        return FORCE
    actuators = mechanism.actuators
    kind = actuators.kinds[actuators.names.index(str(table.actuator))]
    if table.type == "actuator-force":
        return OF_UNIT[kind.force_unit]
    if kind.displacement_unit is None:
        raise ValueError(
            f"a {kind.noun} has no displacement; measure its force, type = "
            '"actuator-force".'
        )
    return OF_UNIT[kind.displacement_unit]


class _Std(TypedDict, total=False):
    std: float


def _std(path: Path, name: str, table: EffectorTable, dimension: Dimension) -> _Std:
    """The standard deviation that the file gives; without one the default is kept."""
    if table.std is None:
        return {}
    with at(path, f"effectors.{name}.std"):
        return {"std": parse_scalar(table.std, dimension)}


def _effector(name: str, table: EffectorTable, std: _Std) -> AbstractEffector:
    body, group, actuator = str(table.body), str(table.group), str(table.actuator)
    if table.type == "frame":
        frame = BodyFrame(name, body, point=table.point, **std)
        if table.std_angle is None:
            return frame
        return replace(frame, std_angle=table.std_angle)
    if table.type == "centroid":
        return Centroid(name, group, **std)
    if table.type == "angle":
        axis = table.axis or (0.0, 0.0, 0.0)
        return BodyAngle(name, body, str(table.other), axis, **std)
    if table.type == "actuator-displacement":
        return ActuatorDisplacement(name, actuator, **std)
    if table.type == "actuator-force":
        return ActuatorForce(name, actuator, **std)
    return SupportReaction(name, group, **std)


def _value(
    folder: Path,
    table: EffectorTable,
    effector: AbstractEffector,
    value: Any,
    mechanism: Mechanism,
) -> Any:
    """The measured value in SI units, as the effector takes it."""
    dimension = _dimension(table, mechanism)
    if isinstance(effector, BodyFrame):
        if not isinstance(value, MeasuredPoseTable):
            raise ValueError(
                f"got {shown(value)}; expected a pose, like "
                '{ position = "(0, 0, 100) mm", azimuth = "10 deg" } or '
                '{ file = "tracker.csv" }.'
            )
        k = mechanism.bodies.names.index(effector.body)
        rest = mechanism.bodies.origin[k] if effector.point is None else effector.point
        return measured_motion(folder, table, value, rest)
    if isinstance(value, MeasuredPoseTable):
        raise ValueError(
            f'got a table; expected {dimension.name}, since type = "{table.type}".'
        )
    if table.type in ("centroid", "reaction"):
        return np.array(parse_vector(value, dimension))
    return parse_scalar(value, dimension)
