"""Tables of a project file that make configurations, their supports and loads."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from softcal_jax.configurations import LOADS, Configuration, Support
from softcal_jax.equilibrium import Model
from softcal_jax.project import _quantities as typed
from softcal_jax.project._design import with_goals
from softcal_jax.project._effectors import Effectors
from softcal_jax.project._markers import MarkersTable, MeasuredMarkers, MeasuredTable
from softcal_jax.project._mechanism import State, build_actuation, build_states
from softcal_jax.project._problems import WrongKeyError, known_name, under
from softcal_jax.project._setup import ShareOrEstimated
from softcal_jax.project._table import (
    Choice,
    Maker,
    Table,
    TableOr,
    WholeFile,
    by_keys,
    only,
    table_of,
)

_Name = Annotated[str, Field(min_length=1)]


def _load_table(value: Any, _: Any) -> type[Maker]:
    return by_keys(value, [table_of(kind, name=_Name) for kind in LOADS])


SupportTable = Annotated[Maker, only(Support)]
LoadTable = Annotated[Maker, Choice(_load_table)]


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
    loads: tuple[LoadTable, ...] = ()
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
            supports.append(support.build())
            mesh.nodes(supports[-1].where)  # raises if there is no such group
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
