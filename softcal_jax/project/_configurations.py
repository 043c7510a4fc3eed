"""Tables of a project file that make configurations, their supports and loads.

To add a load, write one table and list it in `AnyLoad`.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field, field_validator

from softcal_jax._names import UNNAMED_LOADS
from softcal_jax.configurations import (
    Configuration,
    EdgeForce,
    Markers,
    PointForce,
    Registration,
    Support,
    SurfaceForce,
    SurfaceTraction,
    Traces,
)
from softcal_jax.equilibrium import Model
from softcal_jax.project._actuators import build_actuation
from softcal_jax.project._bodies import State, build_states
from softcal_jax.project._effectors import Effectors, with_measured
from softcal_jax.project._markers import (
    MarkersTable,
    MeasuredMarkers,
    MeasuredTable,
)
from softcal_jax.project._problems import WrongKeyError, known_name, under
from softcal_jax.project._quantities import shown
from softcal_jax.project._table import (
    Acceleration,
    AccelerationSize,
    Choice,
    Direction,
    Force,
    Maker,
    Position,
    Stiffness,
    Surface,
    Table,
    TableOr,
    Traction,
    Triple,
    by_keys,
)
from softcal_jax.project._uncertain import ShareOrEstimated
from softcal_jax.project._whole_file import WholeFile


class SupportTable(Maker):
    makes = Support
    group: str = Field(description="name of a group of the mesh")
    axes: str = "xyz"
    displacement: Position = (0.0, 0.0, 0.0)
    stiffness: Stiffness | None = None


class LoadTable(Maker):
    by_name = ("name",)
    name: str = Field(
        UNNAMED_LOADS,
        min_length=1,
        description="name, for `load_factor` in [[setup]]",
    )


TotalForce = Annotated[Force, Field(description='the total force: "(0, 0, -1) N"')]


class PointForceTable(LoadTable):
    makes = PointForce
    point: Position = Field(description='where it acts: "(50, 10, 0) mm"')
    force: TotalForce


class EdgeForceTable(LoadTable):
    makes = EdgeForce
    edge: str = Field(description="name of the node group of an edge")
    force: TotalForce


class SurfaceForceTable(LoadTable):
    makes = SurfaceForce
    surface: Surface
    force: TotalForce


class SurfaceTractionTable(LoadTable):
    makes = SurfaceTraction
    surface: Surface
    traction: Traction = Field(description='force per area: "(0, 0, -1) kPa"')


AnyLoad = Annotated[
    PointForceTable | EdgeForceTable | SurfaceForceTable | SurfaceTractionTable,
    Choice(by_keys),
]


class GravityTable(Table):
    """Gravity as size and direction."""

    size: AccelerationSize = Field(description='"9.81 m/s^2"')
    direction: Direction = Field(description='"-z", or [0, 0, -1]')


class CandidateTable(Table):
    """A configuration that might be measured."""

    name: str = Field(description="name in results, tables and pictures")
    gravity: TableOr[GravityTable, Acceleration] = Field(
        description='"(0, 0, -9.81) m/s^2", here or for all in [shared]'
    )
    supports: tuple[SupportTable, ...] = ()
    loads: tuple[AnyLoad, ...] = ()
    markers: tuple[str, ...] | None = None
    effectors: tuple[str, ...] | None = None
    actuation: dict[str, Any] = Field(default_factory=dict)
    bodies: dict[str, State] = Field(default_factory=dict)
    relative_std: ShareOrEstimated = 0.0

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

    @classmethod
    def foreign(cls, key: str) -> str | None:
        """Say where measured values belong."""
        if key != "measured":
            return None
        return (
            "a candidate is what might be measured; once it is, make it one of "
            "[[configurations]]."
        )

    @property
    def acceleration(self) -> Triple:
        """Gravity [m/s2]."""
        if not isinstance(self.gravity, GravityTable):
            return self.gravity
        x, y, z = (self.gravity.size * v for v in self.gravity.direction)
        return x, y, z


class ConfigurationTable(CandidateTable):
    """A configuration, measured or not."""

    role: Literal["calibration", "validation"] = "calibration"
    recording: str | None = None
    measured: MeasuredTable | None = None

    @field_validator("measured", mode="before")
    @classmethod
    def _not_yet(cls, value: Any) -> Any:
        """Read false as none: what [shared] says of readings is not of this pose."""
        if value is True:
            raise ValueError(
                "got true; expected a table, or false for a pose that is not measured "
                "yet."
            )
        return None if value is False else value


def _reference(name: str, measured: MeasuredTable | None) -> str | None:
    """Return the configuration that displacements are from; none is its own."""
    reference = None if measured is None else measured.displacement_from
    return reference if isinstance(reference, str) and reference != name else None


class Built(NamedTuple):
    """A configuration, and where its measured markers are from.

    Attributes:
        configuration: The configuration.
        registration: Registration of the frame of its cameras, if any.
        traces: The recording of its markers and what was used of it, if any.
    """

    configuration: Configuration
    registration: Registration | None
    traces: Traces | None


def _read_markers(
    own: MeasuredTable, folder: Path, table: MarkersTable, markers: Markers
) -> MeasuredMarkers:
    """Read the markers of a pose; if it selects none, it may not be measured yet."""
    try:
        return own.build(folder, table, markers)
    except ValueError as error:
        if own.select or own.recording or isinstance(error, WrongKeyError):
            raise
        raise ValueError(
            f"{error} If this pose is not measured yet, give it `measured = false`."
        ) from None


def build_configuration(
    folder: Path,
    table: CandidateTable,
    project: WholeFile,
    model: Model,
    effectors: Effectors,
) -> Built:
    """Build a configuration, with what was measured.

    Args:
        folder: Folder that relative paths start from.
        table: The configuration or candidate, with [shared] merged in.
        project: The whole file.
        model: The model.
        effectors: The effectors of the project, without measured values.
    """
    mesh, mechanism = model.mesh, model.mechanism
    supports, loads = [], []
    for i, support in enumerate(table.supports, start=1):
        with under(f"supports[{i}]"):
            mesh.nodes(support.group)  # raises if there is no such group
            supports.append(support.build())
    for i, load in enumerate(table.loads, start=1):
        with under(f"loads[{i}]"):
            loads.append(load.build())
            loads[-1].nodal_forces(mesh)  # raises if there is no such place
    no_markers = ValueError("the project has no markers; add a table [markers].")
    markers = positions = registration = traces = None
    with under("markers"):
        if project.markers is not None:
            markers = project.markers.build(table.markers)
        elif table.markers is not None:
            raise no_markers
    with under("effectors"):
        chosen = effectors if table.effectors is None else table.effectors
        for name in chosen:
            known_name("effector", name, effectors, "[effectors]")
    with under("actuation"):
        actuation = build_actuation(
            table.actuation, project.actuators, mechanism, table.name
        )
    with under("bodies"):
        states = build_states(table.bodies, mechanism)
    own = table.measured if isinstance(table, ConfigurationTable) else None
    if own is not None and own.file is not None:
        with under("measured"):
            if project.markers is None or markers is None:
                raise no_markers
            found = _read_markers(own, folder, project.markers, markers)
            positions, std, registration, traces = found
            if std is not None:
                markers = replace(markers, std=std)
    with under("measured.effectors"):
        followed = with_measured(
            {name: effectors[name] for name in chosen},
            measured={} if own is None else own.effectors,
            tables=project.effectors,
            folder=folder,
            model=model,
        )
    configuration = Configuration(
        name=table.name,
        supports=supports,
        gravity=table.acceleration,
        loads=loads,
        markers=markers,
        measured=positions,
        effectors=followed,
        bodies=states,
        actuation=actuation,
        recording=getattr(table, "recording", None),
        displacement_from=_reference(table.name, own),
        relative_std=table.relative_std,
    )
    return Built(configuration, registration, traces)
