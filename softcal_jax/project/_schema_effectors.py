"""The keys of a project file that make effectors, and what was measured of them."""

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from softcal_jax.project._table import (
    Angle,
    Direction,
    Integer,
    Number,
    Position,
    RotationVector,
    Table,
    table_or_vector,
)

Selection = dict[str, str]
"""Columns of a file of readings and the values that its rows must have."""


class OrientationTable(Table):
    """Which way axes point: angles as trackers have them, or another form."""

    azimuth: Angle | None = None
    elevation: Angle | None = None
    roll: Angle | None = None
    quaternion: tuple[Number, Number, Number, Number] | None = None
    rotation_vector: RotationVector | None = None

    @property
    def forms(self) -> tuple[str, ...]:
        """The keys of the forms that are given."""
        angles = ("azimuth", "elevation", "roll")
        found = [key for key in angles if getattr(self, key) is not None]
        others = [
            key
            for key in ("quaternion", "rotation_vector")
            if getattr(self, key) is not None
        ]
        return (*found[:1], *others)

    @model_validator(mode="after")
    def _check_form(self) -> "OrientationTable":
        if len(self.forms) > 1:
            raise ValueError(
                f"got {' and '.join(self.forms)}; give the orientation in one form: "
                "azimuth, elevation and roll, or a quaternion, or a rotation_vector."
            )
        return self


class FrameTable(OrientationTable):
    """Where a frame stands, in the frame of the mesh."""

    position: Position = (0.0, 0.0, 0.0)


class EffectorTable(Table):
    """What is measured beside markers; `_kinds` tells which key belongs to which."""

    type: Literal[
        "frame",
        "centroid",
        "angle",
        "actuator-displacement",
        "actuator-force",
        "reaction",
    ] = Field(
        description='"frame", "centroid", "angle", "actuator-displacement", '
        '"actuator-force" or "reaction"'
    )
    body: str | None = None
    other: str | None = None
    axis: Direction | None = None
    group: str | None = None
    actuator: str | None = None
    point: Position | None = None
    orientation: OrientationTable = OrientationTable()
    base: FrameTable = FrameTable()
    std: str | None = None
    std_angle: Angle | None = None


class MeasuredPoseTable(OrientationTable):
    """The pose of a 6-D sensor: written here, or in a file of readings."""

    position: Position | None = None
    file: str | None = None
    format: Literal["table", "polhemus"] = "table"
    length_unit: Literal["m", "cm", "mm", "um", "inch"] | None = None
    angle_unit: Literal["deg", "rad"] = "deg"
    sensor: str | None = None
    station: Integer | None = None
    select: Selection = Field(default_factory=dict)
    displacement_from: Selection | None = None

    @model_validator(mode="after")
    def _check(self) -> "MeasuredPoseTable":
        given = self.model_fields_set - {"position", *OrientationTable.model_fields}
        if self.file is None and self.position is None:
            raise ValueError(
                "expected the pose, { position = ..., azimuth = ..., elevation = ..., "
                'roll = ... }, or where it was read, { file = "tracker.csv" }.'
            )
        if self.file is None and given:
            raise ValueError(
                f"{sorted(given)[0]} belongs to a file, which is not there; add `file`."
            )
        if self.file is None:
            return self
        if self.position is not None or self.forms:
            raise ValueError("got a pose and a file; give one of them.")
        of_other = {
            "table": {"station", "angle_unit"},
            "polhemus": {"sensor", "select", "displacement_from"},
        }
        foreign = sorted(given & of_other[self.format])
        if foreign:
            raise ValueError(
                f'{foreign[0]} does not go with format = "{self.format}": a table has '
                "a header and columns to select by (sensor, select, "
                'displacement_from); "polhemus" is the bare text of a tracker '
                "(station, angle_unit)."
            )
        if self.format == "polhemus" and self.length_unit is None:
            raise ValueError(
                'format = "polhemus" needs length_unit, what the tracker was set to: '
                '"cm" or "inch".'
            )
        return self


Measured = Annotated[
    Annotated[MeasuredPoseTable, Tag("(table)")] | Annotated[Any, Tag("(vector)")],
    Discriminator(table_or_vector),
]
"""A pose, or a quantity as text; of which dimension, its effector tells."""
