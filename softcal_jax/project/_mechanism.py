"""Tables of a project file that make rigid bodies and actuators, and their states."""

import contextlib
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from softcal_jax import actuators
from softcal_jax._files import check_file
from softcal_jax._units import METRES
from softcal_jax.bodies import BodyState, Pose, RigidBody, hinge_axes
from softcal_jax.configurations import (
    ImposedDisplacement,
    ImposedForce,
    Mechanism,
    actuation_arrays,
)
from softcal_jax.contact import SHAPES, AbstractShape, read_surface
from softcal_jax.project import _quantities as typed
from softcal_jax.project._mesh import LengthUnit
from softcal_jax.project._quantities import dimension_of, parse_scalar, shown
from softcal_jax.project._table import (
    File,
    Maker,
    Table,
    TableOr,
    known_name,
    of_type,
    only,
    table_of,
    under,
    wrong_key,
)

SURFACE_FORMATS = ".stl", ".ply", ".obj", ".vtp"


class SurfaceFileTable(Table):
    """The shape of an obstacle in a file."""

    type: str
    file: File = Field(description='a closed surface: "object.stl"')
    length_unit: LengthUnit = Field(description='the length unit of the file: "mm"')

    def build(self) -> AbstractShape:
        """Read the shape."""
        check_file(self.file, "surface file")
        if self.file.suffix.lower() not in SURFACE_FORMATS:
            raise ValueError(
                f"surface file {self.file} has the extension {self.file.suffix!r}; "
                f"expected one of {', '.join(SURFACE_FORMATS)}."
            )
        return read_surface(self.file, length_unit=METRES[self.length_unit])


AnyShape = Annotated[
    Maker | SurfaceFileTable, of_type(SHAPES | {"surface": SurfaceFileTable})
]


class BodyTable(table_of(RigidBody, "name", "shape")):
    """Nodes that move as one, or an obstacle with a shape, which may have no nodes."""

    hinge: typed.Direction | None = None
    shape: AnyShape | None = None

    @model_validator(mode="after")
    def _check(self) -> "BodyTable":
        if not any(self.model_dump(include={"group", "shape"}).values()):
            raise wrong_key(
                "group",
                'missing. Expected a group of the mesh: "x_max", or several; or, for '
                'an obstacle, its shape: { type = "plane" }.',
            )
        if {"hinge", "axes"} <= self.model_fields_set:
            raise ValueError(
                "got hinge and axes; the hinge is the third of the axes: give one."
            )
        return self

    def build(self, name: str) -> RigidBody:
        with under("shape"):
            shape = None if self.shape is None else self.shape.build()
        axes = {} if self.hinge is None else {"axes": hinge_axes(self.hinge)}
        return super().build(name, shape=shape, **axes)


StateName = Literal["held", "hinged", "sliding", "free", "absent"]


class BodyStateTable(table_of(Pose)):
    state: StateName = "held"
    start: Annotated[Maker, only(Pose)] = table_of(Pose)()

    def build(self) -> BodyState:
        return BodyState(self.state, super().build(), self.start.build())


State = TableOr[BodyStateTable, StateName]


def build_states(
    table: Mapping[str, Any], mechanism: Mechanism
) -> dict[str, BodyState | Pose | str]:
    states: dict[str, BodyState | Pose | str] = {}
    for body, state in table.items():
        with under(body):
            known_name("rigid body", body, mechanism.bodies.names, "[bodies]")
            states[body] = state.build() if isinstance(state, Maker) else state
    return states


_actuator = lambda kind: table_of(kind, "name", type=str)
AnyActuator = Annotated[Maker, of_type(actuators.ACTUATORS, _actuator)]


def imposed_on(
    tables: Mapping[str, Maker], name: str, value: Any
) -> ImposedForce | ImposedDisplacement:
    """Parse what is imposed on an actuator; the unit tells force from displacement."""
    known_name("actuator", name, tables, "[actuators]")
    kind: actuators.Kind = tables[name].makes.kind
    releasing, given = False, value
    if isinstance(value, dict):  # a cable with friction: which way it last moved
        unknown = set(value) - {"value", "releasing"}
        if unknown or not isinstance(value.get("releasing", False), bool):
            raise ValueError(
                f"got {shown(value)}; expected a table like "
                '{ value = "2 N", releasing = true }.'
            )
        releasing, given = value.get("releasing", False), value.get("value")
    units = kind.force_unit, kind.displacement_unit
    for impose, unit in zip((ImposedForce, ImposedDisplacement), units, strict=True):
        with contextlib.suppress(ValueError):  # of the other dimension, or neither
            if unit is not None:
                return impose(parse_scalar(given, dimension_of(unit)), releasing)
    raise ValueError(f"got {shown(given)}; expected of a {kind.noun} {kind.imposed}.")


def build_actuation(
    asked: Mapping[str, Any],
    tables: Mapping[str, Maker],
    mechanism: Mechanism,
    name: str,
) -> dict[str, ImposedForce | ImposedDisplacement]:
    imposed: dict[str, ImposedForce | ImposedDisplacement] = {}
    for actuator, value in asked.items():
        with under(actuator):
            imposed[actuator] = imposed_on(tables, actuator, value)
            actuation_arrays(mechanism, {actuator: imposed[actuator]}, name)
    return imposed
