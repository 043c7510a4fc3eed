"""The keys of a project file, as pydantic models; values come out in SI units.

The description of each key is also what a message says about it when it is missing.
"""

import math
import re
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Strict,
    Tag,
    field_validator,
    model_validator,
)

from softcal_jax.project._quantities import (
    ACCELERATION,
    DENSITY,
    FORCE,
    LENGTH,
    PRESSURE,
    parse_scalar,
    scalar,
    vector,
)

Number = Annotated[float, Strict()]
Integer = Annotated[int, Strict()]
Flag = Annotated[bool, Strict()]
Triple = tuple[float, float, float]

Length = Annotated[float, BeforeValidator(scalar(LENGTH))]
Pressure = Annotated[float, BeforeValidator(scalar(PRESSURE))]
Density = Annotated[float, BeforeValidator(scalar(DENSITY))]
Position = Annotated[Triple, BeforeValidator(vector(LENGTH))]
Acceleration = Annotated[Triple, BeforeValidator(vector(ACCELERATION))]
Force = Annotated[Triple, BeforeValidator(vector(FORCE))]
Traction = Annotated[Triple, BeforeValidator(vector(PRESSURE))]

Selection = dict[str, str]
"""Columns of a marker file and the values that its rows must have."""


class Table(BaseModel):
    """A table of the file; a key that it does not know is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _one_of(table: BaseModel, *keys: str) -> str:
    """The one key of some that is given.

    Raises:
        ValueError: If none is, or more than one.
    """
    given = [key for key in keys if getattr(table, key) is not None]
    if len(given) != 1:
        found = f"got {' and '.join(given)}" if given else "got none"
        raise ValueError(f"expected exactly one of {', '.join(keys)}; {found}.")
    return given[0]


class BeamTable(Table):
    """A box of tets, long axis along x; its sides are groups "x_min" to "z_max"."""

    size: Position = Field(description='length, width, height: "(100, 30, 30) mm"')
    cells: tuple[Integer, Integer, Integer] = Field(
        description="cells along x, y and z: [14, 4, 4]"
    )
    origin: Position = (0.0, 0.0, 0.0)
    pattern: Literal["mirrored", "centred"] = "mirrored"


class MeshTable(Table):
    """The mesh: from a file, or a beam."""

    file: str | None = None
    length_unit: Literal["m", "cm", "mm", "um", "inch"] | None = None
    unused_nodes: Literal["error", "drop"] = "error"
    beam: BeamTable | None = None
    element: Literal["quadratic", "linear"] = "quadratic"

    @model_validator(mode="after")
    def _check(self) -> "MeshTable":
        if _one_of(self, "file", "beam") == "file" and self.length_unit is None:
            raise ValueError('a mesh file needs its length_unit, like "mm".')
        return self


class BoxTable(Table):
    """All between two corners."""

    lower: Position = Field(description='a corner: "(0, 0, 0) mm"')
    upper: Position = Field(description='a corner: "(0, 30, 30) mm"')


class PlaneTable(Table):
    """All on a plane."""

    point: Position = Field(description='a point on the plane: "(0, 0, 0) mm"')
    normal: tuple[Number, Number, Number] = Field(description="[0, 0, 1]")


class SphereTable(Table):
    """All in a ball."""

    centre: Position = Field(description='its centre: "(0, 0, 0) mm"')
    radius: Length = Field(description='its radius: "5 mm"')


class GroupTable(Table):
    """A named part of the mesh, by where it is."""

    of: Literal["nodes", "faces", "tets"] = "nodes"
    box: BoxTable | None = None
    plane: PlaneTable | None = None
    sphere: SphereTable | None = None
    tolerance: Length | None = None

    @model_validator(mode="after")
    def _check(self) -> "GroupTable":
        _one_of(self, "box", "plane", "sphere")
        return self


class RegionTable(Table):
    """Other constants in one tet group."""

    E: Pressure | None = None
    nu: Number | None = None
    density: Density | None = None


class MaterialTable(Table):
    """The law and its constants before calibration."""

    law: Literal["neo-hookean", "corotational", "st-venant-kirchhoff"] = Field(
        description='"neo-hookean", "corotational" or "st-venant-kirchhoff"'
    )
    E: Pressure = Field(description='Young\'s modulus: "200 kPa"')
    nu: Number = Field(description="Poisson's ratio: 0.499")
    density: Density = Field(description='mass density: "1070 kg/m^3"')
    formulation: Literal["auto", "displacement", "mean-dilatation"] = "auto"
    regions: dict[str, RegionTable] = {}


_FIELDS = {"E": PRESSURE, "density": DENSITY, "nu": None}


class ParameterTable(Table):
    """One unknown constant of the material."""

    field: Literal["E", "nu", "density"] = Field(description='"E", "nu" or "density"')
    name: str | None = None
    region: str | None = None
    lower: float = Field(description='smallest value allowed: "50 kPa"')
    upper: float = Field(description='largest value allowed: "1 MPa"')
    start: float | None = None
    scale: Literal["log", "linear"] | None = None
    S: float | None = None

    @field_validator("lower", "upper", "start", "S", mode="before")
    @classmethod
    def _parse(cls, value: Any, info: Any) -> Any:
        # `field` stands first, so it is known here unless it was wrong itself.
        dimension = _FIELDS.get(info.data.get("field", "nu"))
        if dimension is not None:
            return parse_scalar(value, dimension)
        if info.data.get("field") == "nu" and (
            isinstance(value, bool) or not isinstance(value, int | float)
        ):
            raise ValueError(f"got {value!r}; expected a number, like 0.45.")
        return 0.0 if "field" not in info.data else value


class MarkerEntry(Table):
    """A marker with its own precision."""

    position: Position = Field(description='"(0, 15, 36) mm"')
    std: Length | None = None


def _kind(value: Any) -> str:
    return "(table)" if isinstance(value, dict) else "(vector)"


class MarkersTable(Table):
    """Where the markers stand at rest, in the frame of the mesh."""

    positions: dict[
        str,
        Annotated[
            Annotated[MarkerEntry, Tag("(table)")]
            | Annotated[Position, Tag("(vector)")],
            Discriminator(_kind),
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
        where = _one_of(self, "point", "edge", "surface")
        if _one_of(self, "force", "traction") == "traction" and where != "surface":
            raise ValueError(
                f"a traction acts on a surface, not on the {where}; give a force."
            )
        return self


class RegistrationTable(Table):
    """From the frame of the cameras to the frame of the mesh."""

    markers: tuple[str, ...] = Field(description='markers to fit: ["4", "5", "6"]')
    select: Selection = {}


class MeasuredTable(Table):
    """Where the measured positions are, and how they become positions on the mesh."""

    file: str = Field(description='a CSV file: "markers.csv"')
    length_unit: Literal["m", "cm", "mm", "um", "inch"] | None = None
    recording: Selection = {}
    select: Selection = {}
    registration: RegistrationTable | None = None
    displacement_from: Selection | None = None


def _parse_direction(value: Any) -> Any:
    """A unit vector from "-z" or [0, 0, -1]."""
    if isinstance(value, str):
        axis = re.fullmatch(r"([+-]?)([xyz])", value.strip())
        if axis is None:
            raise ValueError(f'got "{value}"; expected "-z" or [0, 0, -1].')
        sign = -1.0 if axis[1] == "-" else 1.0
        return tuple(sign * (letter == axis[2]) for letter in "xyz")
    numbers = value if isinstance(value, list) else []
    if len(numbers) != 3 or not all(type(v) in (int, float) for v in numbers):
        raise ValueError(f'got {value}; expected "-z" or [0, 0, -1].')
    length = math.hypot(*numbers)
    if not 0.0 < length < math.inf:
        raise ValueError(f"got {value}; a direction has a finite length above zero.")
    return tuple(v / length for v in numbers)


class GravityTable(Table):
    """Gravity by size and direction."""

    size: Annotated[float, BeforeValidator(scalar(ACCELERATION))] = Field(
        description='"9.81 m/s^2"'
    )
    direction: Annotated[Triple, BeforeValidator(_parse_direction)] = Field(
        description='"-z", or [0, 0, -1]'
    )


class ConfigurationTable(Table):
    """One posed robot."""

    name: str = Field(description="name in results, tables and pictures")
    role: Literal["calibration", "validation"] = "calibration"
    gravity: Annotated[
        Annotated[GravityTable, Tag("(table)")]
        | Annotated[Acceleration, Tag("(vector)")],
        Discriminator(_kind),
    ] = Field(description='"(0, 0, -9.81) m/s^2", here or for all in [shared]')
    supports: tuple[SupportTable, ...] = ()
    loads: tuple[LoadTable, ...] = ()
    markers: tuple[str, ...] | None = None
    measured: MeasuredTable | None = None


class SettingsTable(Table):
    """Settings of the calibration; what is left out keeps its default."""

    noise: Literal["estimated", "stated"] = "estimated"
    tol: Number | None = None
    max_steps: Integer | None = None
    step_bound: Number | None = None
    adapt: Flag | None = None


class NewtonTable(Table):
    """Settings of the equilibrium; what is left out keeps its default."""

    rtol: Number | None = None
    max_steps: Integer | None = None
    max_steps_per_load: Integer | None = None
    smallest_load_step: Number | None = None


class ProjectTable(Table):
    """A whole project file."""

    name: str = Field(description="name of the project")
    mesh: MeshTable = Field(description="a table [mesh]")
    groups: dict[str, GroupTable] = {}
    material: MaterialTable = Field(description="a table [material]")
    parameters: tuple[ParameterTable, ...] = ()
    markers: MarkersTable | None = None
    configurations: tuple[ConfigurationTable, ...] = Field(
        description="at least one table [[configurations]]"
    )
    settings: SettingsTable = SettingsTable()
    newton: NewtonTable = NewtonTable()

    @field_validator("configurations")
    @classmethod
    def _check(cls, tables: tuple[ConfigurationTable, ...]) -> Any:
        if not tables:
            raise ValueError("expected at least one table [[configurations]].")
        return tables
