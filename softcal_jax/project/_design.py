"""Configurations of a project file, their supports and loads, and [design]."""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, StrictBool, StrictFloat, field_validator

from softcal_jax import designs
from softcal_jax._module import Module, key, keys
from softcal_jax._text import check_known
from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import (
    LOADS,
    AbstractEffector,
    Configuration,
    ImposedForce,
    Support,
)
from softcal_jax.control import Limits, with_marker_goals
from softcal_jax.equilibrium import Model
from softcal_jax.project import _quantities as typed
from softcal_jax.project._markers import MarkersTable, MeasuredMarkers, MeasuredTable
from softcal_jax.project._quantities import parse_vector
from softcal_jax.project._robot import (
    State,
    build_actuation,
    build_states,
    imposed_on,
)
from softcal_jax.project._sensors import Effectors, WrittenPoseTable, build_effectors
from softcal_jax.project._table import (
    Choice,
    File,
    Maker,
    Table,
    TableOr,
    WholeFile,
    WrongKeyError,
    built,
    by_keys,
    known_name,
    only,
    table_of,
    under,
)

_Name = Annotated[str, Field(min_length=1)]


RelativeStd = Annotated[float | Literal["estimated"], typed.deviation("%", "estimated")]
SupportTable = Annotated[Maker, only(Support)]
LoadTable = Annotated[
    Maker,
    Choice(lambda value, _: by_keys(value, [table_of(k, name=_Name) for k in LOADS])),
]


@keys(
    size=key("m/s2", 'its size: "9.81 m/s^2"', "any"),
    direction=key(words='its direction: "-z" or [0, 0, -1]'),
)
def acceleration(size: float, direction: typed.Direction) -> typed.Triple:
    x, y, z = (size * v for v in direction)
    return x, y, z


class CandidateTable(Table):
    """A configuration that might be measured."""

    name: str = Field(description="name in results, tables and pictures")
    gravity: TableOr[Annotated[Maker, only(acceleration)], typed.Acceleration] = Field(
        description='"(0, 0, -9.81) m/s^2", here or for all in [shared]'
    )
    supports: tuple[SupportTable, ...] = ()
    loads: tuple[LoadTable, ...] = ()
    markers: tuple[str, ...] | None = None
    effectors: tuple[str, ...] | None = None
    actuation: dict[str, Any] = Field(default_factory=dict)
    bodies: dict[str, State] = Field(default_factory=dict)
    relative_std: RelativeStd = 0.0


class ConfigurationTable(CandidateTable):
    role: Literal["calibration", "validation"] = "calibration"
    recording: str | None = None
    after: str | None = Field(None, description="name of another pose")
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
    table: CandidateTable, project: WholeFile, model: Model, effectors: Effectors
) -> Posed:
    """Build a configuration or candidate, with what was measured.

    The `effectors` are without measured values.
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
    seen = _markers_of(table, measured, project.markers)
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
            followed[name] = read(followed[name], value, model)
    reference = None if measured is None else measured.displacement_from
    if not isinstance(reference, str) or reference == table.name:
        reference = None
    configuration = Configuration(
        name=table.name,
        supports=supports,
        gravity=built(table.gravity),
        loads=loads,
        markers=seen.markers,
        measured=seen.positions,
        effectors=tuple(followed.values()),
        bodies=states,
        actuation=actuation,
        recording=getattr(table, "recording", None),
        after=getattr(table, "after", None),
        displacement_from=reference,
        relative_std=table.relative_std,
    )
    goal = getattr(table, "goal", None)
    if goal is not None:
        if measured is not None:
            raise ValueError("it has a `goal` and is `measured`; give one of the two.")
        with under("goal"):
            configuration = with_goals(model, project, configuration, goal)
    return configuration, seen


def _markers_of(
    table: CandidateTable, source: MeasuredTable | None, every: MarkersTable | None
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
            return source.build(every, markers)
        except ValueError as error:
            if source.select or source.recording or isinstance(error, WrongKeyError):
                raise
            raise ValueError(
                f"{error} If this pose is not measured yet, give it `measured = false`."
            ) from None


FREE = "-"
"""Stands for a coordinate of a marker without a goal: "(-, -, 3) mm"."""


class DesignTable(Table):
    """What may be designed beside [[parameters]], and how it is printed.

    Without a foam the moduli are free within their bounds; a `table` has those of your
    foam. `robust` asks for the least error as printed. The largest stretch is a length
    over that at rest, the largest stress that of von Mises. A change between
    neighbouring control points of `modulus_change` or `angle_change` costs as much as a
    goal that is a tolerance off.
    """

    foam: Literal[designs.Infill, "none"] = "none"
    table: File | None = None
    solid_modulus: typed.Modulus = designs.TPU
    modulus_error: typed.Share = designs.Printing().moduli
    angle_error: typed.Angle = designs.Printing().angle
    robust: StrictBool = False
    modulus_change: typed.Share | None = None
    angle_change: typed.Angle | None = None
    largest_stretch: StrictFloat | None = None
    largest_stress: typed.Modulus | None = None
    limits: dict[str, str] = Field(default_factory=dict)


class DesignTask(Module):
    """What is to be designed, see `softcal_jax.designs.design`.

    Attributes:
        goals: Configurations with goals.
        limits: Limits of the actuators that are commanded, by name.
        foam: What can be printed; None for moduli within their bounds.
        largest: Limits of stretch and stress anywhere in the body.
        change: Change between neighbouring control points that costs; None for none.
        printing: Errors of printing.
        robust: Whether the error as printed is to be least.
    """

    goals: tuple[Configuration, ...]
    limits: dict[str, Limits]
    foam: designs.FoamTable | None
    largest: designs.PeakLimits
    change: designs.Change | None
    printing: designs.Printing
    robust: bool


def build_design(table: WholeFile, goals: tuple[Configuration, ...]) -> DesignTask:
    """Build the design that a file asks for."""
    asked: DesignTable = table.design
    limits: dict[str, Limits] = {}
    for name, text in asked.limits.items():
        with under(f"limits.{name}"):
            limits[name] = replace(Limits(), **limited(table.actuators, name, text))
    given = asked.model_fields_set & {"table", "solid_modulus"}
    of_own = asked.foam != "Polyfoam" or "table" in given
    if ("solid_modulus" in given and of_own) or (given and asked.foam == "none"):
        raise ValueError(
            "`table` belongs to a foam, and `solid_modulus` to the published Polyfoam, "
            "without a `table`: leave out what does nothing, or name the foam."
        )
    foam = None
    if "solid_modulus" in given:
        foam = designs.published_foam(asked.solid_modulus)
    elif asked.foam != "none":
        with under("table"):
            foam = designs.foam_table(asked.foam, asked.table)
    changes = {"moduli": asked.modulus_change, "angle": asked.angle_change}
    peaks = {"stretch": asked.largest_stretch, "stress": asked.largest_stress}
    stated = lambda values: {k: v for k, v in values.items() if v is not None}
    return DesignTask(
        goals,
        limits,
        foam,
        designs.PeakLimits(**stated(peaks)),
        designs.Change(**stated(changes)) if stated(changes) else None,
        designs.Printing(asked.modulus_error, asked.angle_error),
        asked.robust,
    )


def with_goals(
    model: Model,
    table: WholeFile,
    configuration: Configuration,
    goals: Mapping[str, Any],
) -> Configuration:
    """Give a configuration goals in the words of a project file, and no others."""
    markers = configuration.markers
    effectors = build_effectors(table.effectors, model.mesh, model.mechanism)
    known = [*effectors, *(() if markers is None else markers.names)]
    aimed: list[AbstractEffector] = []
    places: dict[str, Float[HostArray, 3]] = {}
    for name, value in goals.items():
        check_known("marker or effector with a goal", known, name)
        with under(f"goal of {name!r}"):
            if name not in effectors:
                places[name] = _place(value)
                continue
            if isinstance(value, dict):
                value = WrittenPoseTable.model_validate(value)
            kind = table.effectors[name]
            aimed.append(kind.measured(effectors[name], value, model))
    return replace(with_marker_goals(configuration, places), effectors=tuple(aimed))


def limited(
    tables: Mapping[str, Maker], name: str, text: str
) -> dict[str, tuple[float, float]]:
    """Parse limits of an actuator; the unit tells force from displacement."""
    ends = re.split(r"\s+to\s+", text.strip())
    if len(ends) != 2:
        raise ValueError(f'got {text!r}; expected lowest to highest: "0 N to 5 N".')
    low, high = (imposed_on(tables, name, end) for end in ends)
    if type(low) is not type(high):
        raise ValueError(
            f"{ends[0]!r} and {ends[1]!r} are of different kinds; expected both in "
            "units of its force, or of its displacement."
        )
    key = "force" if isinstance(low, ImposedForce) else "displacement"
    return {key: (low.value, high.value)}


def _place(text: Any) -> Float[HostArray, "3"]:
    """Parse the goal of a marker; NaN for coordinates that are left free."""
    coordinates = str(text).partition("(")[2].partition(")")[0].split(",")
    free = [coordinate.strip() == FREE for coordinate in coordinates]
    filled = re.sub(rf"(?<=[(,])\s*{FREE}\s*(?=[,)])", "0", str(text))
    place = np.array(parse_vector(filled, "m"))
    return np.where(free, np.nan, place)
