"""The keys of a project file that make configurations: supports, loads, markers."""

from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    field_validator,
    model_validator,
)

from softcal_jax.project._problems import shown
from softcal_jax.project._quantities import ACCELERATION, scalar
from softcal_jax.project._schema_effectors import Measured, Selection
from softcal_jax.project._schema_mechanism import BodyStateTable
from softcal_jax.project._table import (
    Acceleration,
    Direction,
    Force,
    Length,
    Position,
    Table,
    Traction,
    one_of,
    table_or_vector,
)


class MarkerEntry(Table):
    """A marker with its own precision."""

    position: Position = Field(description='"(0, 15, 36) mm"')
    std: Length | None = None


class MarkersTable(Table):
    """Where the markers stand at rest, in the frame of the mesh."""

    positions: dict[
        str,
        Annotated[
            Annotated[MarkerEntry, Tag("(table)")]
            | Annotated[Position, Tag("(vector)")],
            Discriminator(table_or_vector),
        ],
    ] = Field(description="names and positions of the markers")
    std: Length = 1e-3
    axes: str = "xyz"
    max_distance: Length = 0.01
    base_radius: Length = 0.0


class SupportTable(Table):
    """Nodes that are held, or moved by a displacement."""

    group: str = Field(description="name of a group of the mesh")
    axes: str = "xyz"
    displacement: Position = (0.0, 0.0, 0.0)


class LoadTable(Table):
    """A dead load at a point, along an edge, or over a surface."""

    point: Position | None = None
    edge: str | None = None
    surface: str | None = None
    force: Force | None = None
    traction: Traction | None = None

    @model_validator(mode="after")
    def _check(self) -> "LoadTable":
        where = one_of(self, "point", "edge", "surface")
        if one_of(self, "force", "traction") == "traction" and where != "surface":
            raise ValueError(
                f"a traction acts on a surface, not on the {where}; give a force."
            )
        return self


class RegistrationTable(Table):
    """From the frame of the cameras to the frame of the mesh."""

    markers: tuple[str, ...] = Field(description='markers to fit: ["4", "5", "6"]')
    select: Selection = Field(default_factory=dict)


class MeasuredTable(Table):
    """Where the measured positions are, and how they become positions on the mesh.

    `effectors` holds what was measured beside markers.
    """

    file: str | None = None
    length_unit: Literal["m", "cm", "mm", "um", "inch"] | None = None
    recording: Selection = Field(default_factory=dict)
    select: Selection = Field(default_factory=dict)
    registration: RegistrationTable | None = None
    displacement_from: Selection | None = None
    effectors: dict[str, Measured] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> "MeasuredTable":
        given = sorted(self.model_fields_set - {"file", "effectors"})
        if self.file is None and (given or not self.effectors):
            which = f"{given[0]} is for the file of the markers; " if given else ""
            raise ValueError(
                f'{which}expected file = "markers.csv", or `effectors` with what was '
                "measured beside markers."
            )
        return self


class GravityTable(Table):
    """Gravity by size and direction."""

    size: Annotated[float, BeforeValidator(scalar(ACCELERATION))] = Field(
        description='"9.81 m/s^2"'
    )
    direction: Direction = Field(description='"-z", or [0, 0, -1]')


class CandidateTable(Table):
    """One posed robot that might be measured."""

    name: str = Field(description="name in results, tables and pictures")
    gravity: Annotated[
        Annotated[GravityTable, Tag("(table)")]
        | Annotated[Acceleration, Tag("(vector)")],
        Discriminator(table_or_vector),
    ] = Field(description='"(0, 0, -9.81) m/s^2", here or for all in [shared]')
    supports: tuple[SupportTable, ...] = ()
    loads: tuple[LoadTable, ...] = ()
    markers: tuple[str, ...] | None = None
    effectors: tuple[str, ...] | None = None
    actuation: dict[str, Any] = Field(default_factory=dict)
    bodies: dict[
        str,
        Annotated[
            Annotated[BodyStateTable, Tag("(table)")]
            | Annotated[Literal["held", "hinged", "free"], Tag("(vector)")],
            Discriminator(table_or_vector),
        ],
    ] = Field(default_factory=dict)

    @field_validator("supports", mode="before")
    @classmethod
    def _check_supports(cls, value: Any) -> Any:
        groups = value if isinstance(value, list) else [value]
        if not groups or isinstance(groups[0], dict):
            return value
        names = ", ".join(f"{{ group = {shown(group)} }}" for group in groups)
        raise ValueError(
            f"got {shown(value)}; expected a list of tables, like [{names}]."
        )


class ConfigurationTable(CandidateTable):
    """One posed robot, measured or to be measured."""

    role: Literal["calibration", "validation"] = "calibration"
    measured: MeasuredTable | None = None
