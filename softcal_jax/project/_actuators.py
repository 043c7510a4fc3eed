"""Tables of a project file that make actuators and say what is imposed on them.

To add an actuator, write one table with the keys of its class and list it in
`AnyActuator`.
"""

import contextlib
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator

from softcal_jax.actuators import (
    AbstractActuator,
    Cable,
    Chamber,
    ForceActuator,
    Guide,
    Motor,
    SurfaceForceActuator,
    SurfacePressure,
)
from softcal_jax.configurations import (
    ImposedDisplacement,
    ImposedForce,
    Mechanism,
    actuation_arrays,
)
from softcal_jax.project._problems import known_name, under
from softcal_jax.project._quantities import dimension_of, parse_scalar, shown
from softcal_jax.project._table import (
    Choice,
    Direction,
    Flag,
    Maker,
    Position,
    Surface,
    by_type,
)

Positive = Annotated[
    Direction, Field(description='direction of a positive force: "-z", or [0, 0, -1]')
]


class ActuatorTable(Maker):
    """An actuator; `asked` says what may be imposed on it, with an example of each."""

    makes: ClassVar[type[AbstractActuator]]
    asked: ClassVar[str] = 'its force, like "2 N", or its displacement, like "5 mm"'

    def imposed(self, value: Any) -> ImposedForce | ImposedDisplacement:
        """Parse an imposed force or displacement; the unit tells which it is."""
        releasing = False
        if isinstance(value, dict):  # a cable with friction: which way it last moved
            unknown = set(value) - {"value", "releasing"}
            if unknown or not isinstance(value.get("releasing", False), bool):
                raise ValueError(
                    f"got {shown(value)}; expected a table like "
                    '{ value = "2 N", releasing = true }.'
                )
            releasing, value = value.get("releasing", False), value.get("value")
        kind = self.makes.kind
        forms = {
            ImposedForce: kind.force_unit,
            ImposedDisplacement: kind.displacement_unit,
        }
        for impose, unit in forms.items():
            with contextlib.suppress(ValueError):  # of the other dimension, or neither
                if unit is not None:
                    return impose(parse_scalar(value, dimension_of(unit)), releasing)
        raise ValueError(
            f"got {shown(value)}; expected of a {kind.noun}, {self.asked}."
        )


class GuideTable(Maker):
    makes = Guide
    point: Position = Field(description='where it is at rest: "(50, 10, 0) mm"')
    on: str = "mesh"


class CableTable(ActuatorTable):
    makes = Cable
    asked = 'its tension, like "2 N", or its shortening, like "5 mm"'
    type: Literal["cable"]
    guides: tuple[GuideTable, ...] = Field(
        description="the points that it runs through, both ends included: "
        '[{ point = "(0, 10, 0) mm", on = "ground" }, "(50, 10, 0) mm"]'
    )
    friction: float | None = None
    pulled_from: Literal["first", "last"] | None = None

    @field_validator("guides", mode="before")
    @classmethod
    def _check_guides(cls, value: Any) -> Any:
        if not isinstance(value, list):
            return value
        return [g if isinstance(g, dict) else {"point": g} for g in value]


class ChamberTable(ActuatorTable):
    makes = Chamber
    asked = 'its pressure, like "10 kPa", or its growth in volume, like "2 ml"'
    type: Literal["chamber"]
    surface: str = Field(description='the surface group of its whole wall: "cavity"')
    seal: Flag = False


class SurfacePressureTable(ActuatorTable):
    makes = SurfacePressure
    asked = 'its pressure, like "10 kPa"'
    type: Literal["surface-pressure"]
    surface: Surface


class MotorTable(ActuatorTable):
    makes = Motor
    asked = 'its torque, like "50 N*mm", or its angle, like "30 deg"'
    type: Literal["motor"]
    body: str = Field(description='the rigid body that it turns, with a hinge: "arm"')


class ForceActuatorTable(ActuatorTable):
    makes = ForceActuator
    type: Literal["point-force"]
    point: Position = Field(description='where it acts: "(50, 10, 0) mm"')
    direction: Positive


class SurfaceForceActuatorTable(ActuatorTable):
    makes = SurfaceForceActuator
    type: Literal["surface-force"]
    surface: Surface
    direction: Positive


AnyActuator = Annotated[
    CableTable
    | ChamberTable
    | SurfacePressureTable
    | MotorTable
    | ForceActuatorTable
    | SurfaceForceActuatorTable,
    Choice(by_type),
]


def build_actuation(
    asked: Mapping[str, Any],
    tables: Mapping[str, ActuatorTable],
    mechanism: Mechanism,
    name: str,
) -> dict[str, ImposedForce | ImposedDisplacement]:
    """Parse the forces and displacements that a configuration imposes, by actuator."""
    imposed: dict[str, ImposedForce | ImposedDisplacement] = {}
    for actuator, value in asked.items():
        with under(actuator):
            known_name("actuator", actuator, tables, "[actuators]")
            imposed[actuator] = tables[actuator].imposed(value)
            actuation_arrays(mechanism, {actuator: imposed[actuator]}, name)
    return imposed
