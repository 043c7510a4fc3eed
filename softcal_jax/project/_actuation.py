"""What a configuration of a project file asks of actuators and rigid bodies."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax.bodies import BodyState, Pose
from softcal_jax.configurations import (
    ImposedDisplacement,
    ImposedForce,
    Mechanism,
    actuation_arrays,
)
from softcal_jax.project._mechanism import motion
from softcal_jax.project._problems import at, known_name, shown
from softcal_jax.project._quantities import OF_UNIT, parse_either
from softcal_jax.project._schema_mechanism import BodyStateTable

Actuation = dict[str, ImposedForce | ImposedDisplacement]

_FORCE, _DISPLACEMENT = 'its force, like "2 N"', 'its displacement, like "5 mm"'
_ASKED = {
    "cable": ('its tension, like "2 N"', 'its shortening, like "5 mm"'),
    "chamber": ('its pressure, like "10 kPa"', 'its growth in volume, like "2 ml"'),
    "surface pressure": ('its pressure, like "10 kPa"', None),
    "motor": ('its torque, like "50 N*mm"', 'its angle, like "30 deg"'),
    "force actuator": (_FORCE, _DISPLACEMENT),
    "surface force actuator": (_FORCE, _DISPLACEMENT),
}
"""What may be asked of each kind of actuator: lambda_a or delta_a."""


def build_actuation(
    path: Path, key: str, table: dict[str, Any], mechanism: Mechanism, name: str
) -> Actuation:
    """Imposed forces and displacements; the unit of a value tells which it is.

    Args:
        path: The project file, for messages.
        key: Key of the table in it.
        table: What is asked, by the names of actuators.
        mechanism: The actuators.
        name: Name of the configuration, for messages.

    Raises:
        ProjectError: If an actuator is unknown, or a value is not what it can be
            asked for.
    """
    asked: Actuation = {}
    for actuator, value in table.items():
        with at(path, f"{key}.{actuator}"):
            known_name("actuator", actuator, mechanism.actuators.names, "actuators")
            asked[actuator] = _imposed(actuator, value, mechanism)
            actuation_arrays(mechanism, {actuator: asked[actuator]}, name)
    return asked


def _imposed(
    name: str, value: Any, mechanism: Mechanism
) -> ImposedForce | ImposedDisplacement:
    actuators = mechanism.actuators
    kind = actuators.kinds[actuators.names.index(name)]
    force, displacement = _ASKED[kind.noun]
    what = f"of a {kind.noun}, {force}"
    dimensions = [OF_UNIT[kind.force_unit]]
    if kind.displacement_unit is not None:
        dimensions.append(OF_UNIT[kind.displacement_unit])
        what += f", or {displacement}"
    number, dimension = parse_either(value, dimensions, what)
    if dimension is dimensions[0]:
        return ImposedForce(number)
    if kind.noun == "motor" and abs(number) > np.pi:
        raise ValueError(
            f"got {shown(value)}; a motor turns by half a turn at most, -180 to 180 "
            "deg."
        )
    return ImposedDisplacement(number)


def build_states(
    path: Path,
    key: str,
    table: Mapping[str, str | BodyStateTable],
    mechanism: Mechanism,
) -> dict[str, BodyState | Pose | str]:
    """What rigid bodies do, by their names.

    Raises:
        ProjectError: If a body is unknown.
    """
    states: dict[str, BodyState | Pose | str] = {}
    for body, own in table.items():
        with at(path, f"{key}.{body}"):
            known_name("rigid body", body, mechanism.bodies.names, "bodies")
            states[body] = (
                own if isinstance(own, str) else BodyState(own.state, motion(own))
            )
    return states
