"""Tables of a project file that make rigid bodies and actuators, and their states.

To add an actuator, write one table with the keys of its class.
"""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from softcal_jax import actuators
from softcal_jax.bodies import BodyState, Pose, RigidBody, hinge_axes
from softcal_jax.configurations import (
    ImposedDisplacement,
    ImposedForce,
    Mechanism,
    actuation_arrays,
)
from softcal_jax.project import _quantities as typed
from softcal_jax.project._problems import known_name, under
from softcal_jax.project._quantities import dimension_of, parse_scalar, shown
from softcal_jax.project._shapes import AnyShape
from softcal_jax.project._table import Choice, Maker, Table, TableOr, by_type, wrong_key


class MotionTable(Table):
    """A rigid motion of a frame: its translation and rotation vector."""

    translation: typed.Position = (0.0, 0.0, 0.0)
    rotation_vector: typed.RotationVector = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> Pose:
        return Pose(self.translation, self.rotation_vector)


class BodyTable(Table):
    """Nodes that move as one, or an obstacle with a shape, which may have no nodes."""

    group: typed.Names = ()
    origin: typed.Position | None = None
    hinge: typed.Direction | None = None
    axes: tuple[typed.Direction, typed.Direction, typed.Direction] | None = None
    mounting: MotionTable = MotionTable()
    tied_to: str | None = None
    mass: typed.Mass | None = None
    centre_of_mass: typed.Position | None = None
    shape: AnyShape | None = None
    friction: typed.Number = 0.0

    @model_validator(mode="after")
    def _check(self) -> "BodyTable":
        if not self.group and self.shape is None:
            raise wrong_key(
                "group",
                'missing. Expected a group of the mesh: "x_max", or several; or, for '
                'an obstacle, its shape: { type = "plane" }.',
            )
        if self.hinge is not None and self.axes is not None:
            raise ValueError(
                "got hinge and axes; the hinge is the third of the axes: give one."
            )
        return self

    def build(self, name: str, folder: Path) -> RigidBody:
        """Build the body; paths are relative to `folder`."""
        with under("shape"):
            shape = self.shape and self.shape.shape(folder)
        return RigidBody(
            name=name,
            where=self.group,
            axes=self.axes if self.hinge is None else hinge_axes(self.hinge),
            mounting=self.mounting.pose,
            shape=shape,
            **self.model_dump(
                include={"origin", "tied_to", "mass", "centre_of_mass", "friction"}
            ),
        )

    def files(self, folder: Path) -> tuple[Path, ...]:
        return () if self.shape is None else self.shape.files(folder)


StateName = Literal["held", "hinged", "sliding", "free", "absent"]


class BodyStateTable(MotionTable):
    state: StateName = "held"
    start: MotionTable = MotionTable()


State = TableOr[BodyStateTable, StateName]


def build_states(
    table: Mapping[str, Any], mechanism: Mechanism
) -> dict[str, BodyState | Pose | str]:
    states: dict[str, BodyState | Pose | str] = {}
    for body, state in table.items():
        with under(body):
            known_name("rigid body", body, mechanism.bodies.names, "[bodies]")
            states[body] = state
            if isinstance(state, BodyStateTable):
                states[body] = BodyState(state.state, state.pose, state.start.pose)
    return states


Positive = Annotated[
    typed.Direction,
    Field(description='direction of a positive force: "-z", or [0, 0, -1]'),
]


class ActuatorTable(Maker):
    """An actuator; `asked` says what may be imposed on it, with an example of each."""

    makes: ClassVar[type[actuators.AbstractActuator]]
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
        units = kind.force_unit, kind.displacement_unit
        both = zip((ImposedForce, ImposedDisplacement), units, strict=True)
        for impose, unit in both:
            with contextlib.suppress(ValueError):  # of the other dimension, or neither
                if unit is not None:
                    return impose(parse_scalar(value, dimension_of(unit)), releasing)
        raise ValueError(f"got {shown(value)}; expected of a {kind.noun} {self.asked}.")


class GuideTable(Maker):
    makes = actuators.Guide
    point: typed.Position = Field(description='where it is at rest: "(50, 10, 0) mm"')
    on: str = "mesh"


class CableTable(ActuatorTable):
    makes = actuators.Cable
    asked = 'its tension, like "2 N", or its shortening, like "5 mm"'
    type: Literal["cable"]
    guides: tuple[GuideTable, ...] = Field(
        description="the points that it runs through, both ends included: "
        '[{ point = "(0, 10, 0) mm", on = "ground" }, "(50, 10, 0) mm"]'
    )
    friction: float | None = None
    pulled_from: Literal["first", "last"] | None = None
    max_distance: typed.Length | None = None

    @field_validator("guides", mode="before")
    @classmethod
    def _check_guides(cls, value: Any) -> Any:
        if not isinstance(value, list):
            return value
        return [g if isinstance(g, dict) else {"point": g} for g in value]


class ChamberTable(ActuatorTable):
    makes = actuators.Chamber
    asked = 'its pressure, like "10 kPa", or its growth in volume, like "2 ml"'
    type: Literal["chamber"]
    surface: str = Field(description='the surface group of its whole wall: "cavity"')
    seal: typed.Flag = False


class SurfacePressureTable(ActuatorTable):
    makes = actuators.SurfacePressure
    asked = 'its pressure, like "10 kPa"'
    type: Literal["surface-pressure"]
    surface: typed.Surface


class MotorTable(ActuatorTable):
    makes = actuators.Motor
    asked = 'its torque, like "50 N*mm", or its angle, like "30 deg"'
    type: Literal["motor"]
    body: str = Field(description='the rigid body that it turns, with a hinge: "arm"')


class ForceActuatorTable(ActuatorTable):
    makes = actuators.ForceActuator
    type: Literal["point-force"]
    point: typed.Position = Field(description='where it acts: "(50, 10, 0) mm"')
    direction: Positive
    body: str | None = None


class SurfaceForceActuatorTable(ActuatorTable):
    makes = actuators.SurfaceForceActuator
    type: Literal["surface-force"]
    surface: typed.Surface
    direction: Positive


AnyActuator = Annotated[ActuatorTable, Choice(by_type)]


def build_actuation(
    asked: Mapping[str, Any],
    tables: Mapping[str, ActuatorTable],
    mechanism: Mechanism,
    name: str,
) -> dict[str, ImposedForce | ImposedDisplacement]:
    imposed: dict[str, ImposedForce | ImposedDisplacement] = {}
    for actuator, value in asked.items():
        with under(actuator):
            known_name("actuator", actuator, tables, "[actuators]")
            imposed[actuator] = tables[actuator].imposed(value)
            actuation_arrays(mechanism, {actuator: imposed[actuator]}, name)
    return imposed
