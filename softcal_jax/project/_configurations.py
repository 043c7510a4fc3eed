"""Tables of a project file that make configurations, their supports and loads.

To add a load, write one table.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from softcal_jax import configurations
from softcal_jax._names import UNNAMED_LOADS
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model
from softcal_jax.project import _quantities as typed
from softcal_jax.project._design import with_goals
from softcal_jax.project._effectors import Effectors
from softcal_jax.project._markers import MarkersTable, MeasuredMarkers, MeasuredTable
from softcal_jax.project._mechanism import State, build_actuation, build_states
from softcal_jax.project._problems import WrongKeyError, known_name, under
from softcal_jax.project._setup import ShareOrEstimated
from softcal_jax.project._table import Choice, Maker, Table, TableOr, WholeFile, by_keys


class SupportTable(Maker):
    makes = configurations.Support
    group: str = Field(description="name of a group of the mesh")
    axes: str = "xyz"
    displacement: typed.Position = (0.0, 0.0, 0.0)
    stiffness: typed.Stiffness | None = None


class LoadTable(Maker):
    by_name = ("name",)
    name: str = Field(UNNAMED_LOADS, min_length=1)  # for `load_factor` in [[setup]]


TotalForce = Annotated[typed.Force, Field(description='total force: "(0, 0, -1) N"')]


class PointForceTable(LoadTable):
    makes = configurations.PointForce
    point: typed.Position = Field(description='where it acts: "(50, 10, 0) mm"')
    force: TotalForce


class EdgeForceTable(LoadTable):
    makes = configurations.EdgeForce
    edge: str = Field(description="name of the node group of an edge")
    force: TotalForce


class SurfaceForceTable(LoadTable):
    makes = configurations.SurfaceForce
    surface: typed.Surface
    force: TotalForce


class SurfaceTractionTable(LoadTable):
    makes = configurations.SurfaceTraction
    surface: typed.Surface
    traction: typed.Traction = Field(description='force per area: "(0, 0, -1) kPa"')


AnyLoad = Annotated[LoadTable, Choice(by_keys)]


class GravityTable(Table):
    size: typed.AccelerationSize = Field(description='"9.81 m/s^2"')
    direction: typed.Direction = Field(description='"-z", or [0, 0, -1]')


class CandidateTable(Table):
    """A configuration that might be measured."""

    name: str = Field(description="name in results, tables and pictures")
    gravity: TableOr[GravityTable, typed.Acceleration] = Field(
        description='"(0, 0, -9.81) m/s^2", here or for all in [shared]'
    )
    supports: tuple[SupportTable, ...] = ()
    loads: tuple[AnyLoad, ...] = ()
    markers: tuple[str, ...] | None = None
    effectors: tuple[str, ...] | None = None
    actuation: dict[str, Any] = Field(default_factory=dict)
    bodies: dict[str, State] = Field(default_factory=dict)
    relative_std: ShareOrEstimated = 0.0

    @property
    def acceleration(self) -> typed.Triple:
        """Gravity [m/s2]."""
        if not isinstance(self.gravity, GravityTable):
            return self.gravity
        x, y, z = (self.gravity.size * v for v in self.gravity.direction)
        return x, y, z


class ConfigurationTable(CandidateTable):
    role: Literal["calibration", "validation"] = "calibration"
    recording: str | None = None
    measured: MeasuredTable | None = None
    goal: dict[str, Any] | None = None

    @field_validator("measured", mode="before")
    @classmethod
    def _not_yet(cls, value: Any) -> Any:
        """Read false as None: the readings in [shared] are not of this pose."""
        if value is True:
            raise ValueError("got true; expected a table, or false if not measured.")
        return None if value is False else value


Posed = tuple[Configuration, MeasuredMarkers]
"""A configuration, and how its markers were measured."""


def build_configuration(
    folder: Path,
    table: CandidateTable,
    project: WholeFile,
    model: Model,
    effectors: Effectors,
) -> Posed:
    """Build a configuration or candidate, with what was measured.

    Relative paths start from `folder`, and `effectors` are without measured values.
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
    measured = getattr(table, "measured", None)
    seen = _markers_of(folder, table, measured, project.markers)
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
    followed = {name: effectors[name] for name in chosen}
    for name, value in ({} if measured is None else measured.effectors).items():
        with under(f"measured.effectors.{name}"):
            known_name("effector", name, followed, "[effectors]")
            read = project.effectors[name].measured
            followed[name] = read(followed[name], value, folder, model)
    reference = None if measured is None else measured.displacement_from
    if not isinstance(reference, str) or reference == table.name:
        reference = None
    configuration = Configuration(
        name=table.name,
        supports=supports,
        gravity=table.acceleration,
        loads=loads,
        markers=seen.markers,
        measured=seen.positions,
        effectors=tuple(followed.values()),
        bodies=states,
        actuation=actuation,
        recording=getattr(table, "recording", None),
        displacement_from=reference,
        relative_std=table.relative_std,
    )
    goal = getattr(table, "goal", None)
    if goal is not None:
        if measured is not None:
            raise ValueError("it has a `goal` and is `measured`; give one of the two.")
        with under("goal"):
            configuration = with_goals(folder, model, project, configuration, goal)
    return configuration, seen


def _markers_of(
    folder: Path,
    table: CandidateTable,
    source: MeasuredTable | None,
    every: MarkersTable | None,
) -> MeasuredMarkers:
    """Build the markers of a pose, and read where they were measured."""
    reads = source is not None and source.file is not None
    if every is None:
        if reads or table.markers is not None:
            none = "the project has no markers; add a table [markers]."
            raise WrongKeyError("markers", none)
        return MeasuredMarkers()
    with under("markers"):
        markers = every.build(table.markers)
    if source is None or not reads:
        return MeasuredMarkers(markers)
    with under("measured"):
        try:
            return source.build(folder, every, markers)
        except ValueError as error:
            if source.select or source.recording or isinstance(error, WrongKeyError):
                raise
            raise ValueError(
                f"{error} If this pose is not measured yet, give it `measured = false`."
            ) from None
