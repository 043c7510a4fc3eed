"""The keys of a project file that make rigid bodies, actuators and their errors."""

from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from softcal_jax.project._quantities import ANGLE, LENGTH, parse_scalar
from softcal_jax.project._table import (
    Direction,
    Mass,
    Names,
    Position,
    RotationVector,
    Table,
    one_of,
)


class MotionTable(Table):
    """A rigid motion: how far a frame moves, and by which rotation vector it turns."""

    translation: Position = (0.0, 0.0, 0.0)
    rotation_vector: RotationVector = (0.0, 0.0, 0.0)


class BodyTable(Table):
    """Nodes that move as one."""

    group: Names = Field(description='a group of the mesh: "x_max", or several')
    origin: Position | None = None
    hinge: Direction | None = None
    axes: tuple[Direction, Direction, Direction] | None = None
    mounting: MotionTable = MotionTable()
    tied_to: str | None = None
    mass: Mass = 0.0
    centre_of_mass: Position | None = None

    @model_validator(mode="after")
    def _check(self) -> "BodyTable":
        if self.hinge is not None and self.axes is not None:
            raise ValueError(
                "got hinge and axes; the hinge is the third of the axes, so give one "
                "of them."
            )
        return self


class GuideTable(Table):
    """A point that a cable runs through."""

    point: Position = Field(description='where it is at rest: "(50, 10, 0) mm"')
    on: str = "mesh"


class ActuatorTable(Table):
    """What pulls, blows, turns or pushes; `_kinds` tells which key belongs to which."""

    type: Literal[
        "cable",
        "chamber",
        "surface-pressure",
        "motor",
        "point-force",
        "surface-force",
    ] = Field(
        description='"cable", "chamber", "surface-pressure", "motor", "point-force" or '
        '"surface-force"'
    )
    guides: tuple[GuideTable, ...] = ()
    surface: str | None = None
    body: str | None = None
    point: Position | None = None
    direction: Direction | None = None

    @field_validator("guides", mode="before")
    @classmethod
    def _check_guides(cls, value: Any) -> Any:
        if not isinstance(value, list):
            return value
        return [g if isinstance(g, dict) else {"point": g} for g in value]


class BodyStateTable(MotionTable):
    """What a configuration does with a rigid body."""

    state: Literal["held", "hinged", "free"] = "held"

    @model_validator(mode="after")
    def _check(self) -> "BodyStateTable":
        if self.state == "free" and (any(self.translation + self.rotation_vector)):
            raise ValueError(
                'state = "free" has no pose; to hold the body there, leave `state` out.'
            )
        if self.state == "hinged" and any(self.rotation_vector):
            raise ValueError(
                'state = "hinged" turns as the balance has it; leave `rotation_vector` '
                "out, or hold the body by leaving `state` out."
            )
        return self


class SetupTable(Table):
    """Errors of the setup that are calibrated together with the material."""

    motor_zero: Names | None = None
    mounting: Names | None = None
    limit: float = Field(description='largest error looked for: "3 deg", "2 mm"')
    prior_std: float | None = None

    @field_validator("limit", "prior_std", mode="before")
    @classmethod
    def _parse(cls, value: Any, info: Any) -> Any:
        angle = info.data.get("motor_zero") is not None
        number = parse_scalar(value, ANGLE if angle else LENGTH)
        if not number > 0.0:
            raise ValueError(f'got "{value}"; expected more than zero.')
        return number

    @model_validator(mode="after")
    def _check(self) -> "SetupTable":
        one_of(self, "motor_zero", "mounting")
        return self
