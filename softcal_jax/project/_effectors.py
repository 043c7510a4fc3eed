"""Tables of a project file that make effectors and their measured values.

To add an effector, write one table and list it in `AnyEffector`.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import Discriminator, Field, Tag

from softcal_jax.actuators import Kind
from softcal_jax.configurations import (
    AbstractEffector,
    ActuatorDisplacement,
    ActuatorForce,
    BodyAngle,
    BodyFrame,
    Centroid,
    Mechanism,
    SupportReaction,
)
from softcal_jax.mesh import TetMesh
from softcal_jax.project._problems import known_name, shown, under
from softcal_jax.project._quantities import (
    ANGLE,
    FORCE,
    LENGTH,
    Dimension,
    dimension_of,
    parse_scalar,
    parse_vector,
)
from softcal_jax.project._sensors import (
    FrameTable,
    MeasuredPoseTable,
    OrientationTable,
)
from softcal_jax.project._table import (
    Angle,
    Direction,
    Position,
    Table,
    table_or_vector,
)

Effectors = dict[str, AbstractEffector]

Measured = Annotated[
    Annotated[MeasuredPoseTable, Tag("(table)")] | Annotated[Any, Tag("(vector)")],
    Discriminator(table_or_vector),
]
"""A pose, or a quantity as text, whose dimension the effector knows."""

_BODY = Field(description='name of a rigid body, [bodies.NAME]: "plate"')


class EffectorTable(Table):
    """Something that is measured beside markers.

    Attributes:
        makes: The class that it makes; keys named like its arguments are passed to it.
        measures: Dimension of `std` and the measured value.
        vector: Whether three numbers are measured.
        std: Standard deviation; by default that of the effector's class.
    """

    makes: ClassVar[Callable[..., AbstractEffector]]
    measures: ClassVar[Dimension]
    vector: ClassVar[bool] = False

    std: str | None = None

    def dimension(self, mechanism: Mechanism) -> Dimension:
        """Return the dimension of `std` and the measured value.

        Raises:
            ValueError: If there is nothing to measure.
        """
        del mechanism
        return self.measures

    def build(self, name: str, std: float | None) -> AbstractEffector:
        """Build the effector, without a measured value.

        Args:
            name: Its name.
            std: Its standard deviation in SI, if the file gives one.
        """
        given = {**self._arguments(), "std": std}
        return self.makes(name, **{k: v for k, v in given.items() if v is not None})

    def _arguments(self) -> dict[str, Any]:
        known = inspect.signature(self.makes).parameters
        return {k: getattr(self, k) for k in type(self).model_fields if k in known}

    def value(self, value: Any, folder: Path, mechanism: Mechanism) -> Any:
        """Parse the measured value, in SI units and as the effector takes it.

        Args:
            value: The value in the file.
            folder: Folder that relative paths start from.
            mechanism: Rigid bodies and actuators.

        Raises:
            ValueError: If it is not such a value.
        """
        del folder
        dimension = self.dimension(mechanism)
        if isinstance(value, MeasuredPoseTable):
            (kind,) = get_args(type(self).model_fields["type"].annotation)
            raise ValueError(
                f'got a table; expected {dimension.name}, since type = "{kind}".'
            )
        if self.vector:
            return np.array(parse_vector(value, dimension))
        return parse_scalar(value, dimension)


class BodyFrameTable(EffectorTable):
    """Position and orientation of a rigid body."""

    makes = BodyFrame
    measures = LENGTH

    type: Literal["frame"]
    body: str = _BODY
    point: Position | None = None
    orientation: OrientationTable = OrientationTable()
    base: FrameTable = FrameTable()
    std_angle: Angle | None = None

    def value(self, value: Any, folder: Path, mechanism: Mechanism) -> Any:
        """Parse the motion of the body."""
        if not isinstance(value, MeasuredPoseTable):
            raise ValueError(
                f"got {shown(value)}; expected a pose, like "
                '{ position = "(0, 0, 100) mm", azimuth = "10 deg" } or '
                '{ file = "tracker.csv" }.'
            )
        rest = mechanism.bodies.origin[mechanism.bodies.names.index(self.body)]
        if self.point is not None:
            rest = np.array(self.point)
        return value.motion(folder, self.base, self.orientation, rest)


class _OfGroup(EffectorTable):
    vector = True

    group: str = Field(description='name of a group of the mesh: "x_min"')

    def _arguments(self) -> dict[str, Any]:
        return {"where": self.group}


class CentroidTable(_OfGroup):
    """Mean position of a group of nodes."""

    makes = Centroid
    measures = LENGTH

    type: Literal["centroid"]


class SupportReactionTable(_OfGroup):
    """Force with which the ground holds a group of nodes."""

    makes = SupportReaction
    measures = FORCE

    type: Literal["reaction"]


class BodyAngleTable(EffectorTable):
    """Angle between two rigid bodies."""

    makes = BodyAngle
    measures = ANGLE

    type: Literal["angle"]
    body: str = _BODY
    other: str = Field(description="the rigid body it is measured from")
    axis: Direction = Field(
        description='axis of the angle, fixed on `other`: "z", or [0, 0, 1]'
    )


class _OfActuator(EffectorTable):
    actuator: str = Field(description='name of an actuator, [actuators.NAME]: "cable"')
    std: str | None = Field(
        description='standard deviation, with the unit of what is measured: "0.1 mm"'
    )

    def _kind(self, mechanism: Mechanism) -> Kind:
        actuators = mechanism.actuators
        return actuators.kinds[actuators.names.index(self.actuator)]


class ActuatorDisplacementTable(_OfActuator):
    """Displacement of an actuator."""

    makes = ActuatorDisplacement

    type: Literal["actuator-displacement"]

    def dimension(self, mechanism: Mechanism) -> Dimension:
        """Return the dimension of the actuator's displacement."""
        kind = self._kind(mechanism)
        if kind.displacement_unit is None:
            raise ValueError(
                f"a {kind.noun} has no displacement; measure its force, type = "
                '"actuator-force".'
            )
        return dimension_of(kind.displacement_unit)


class ActuatorForceTable(_OfActuator):
    """Force of an actuator."""

    makes = ActuatorForce

    type: Literal["actuator-force"]

    def dimension(self, mechanism: Mechanism) -> Dimension:
        """Return the dimension of the actuator's force."""
        return dimension_of(self._kind(mechanism).force_unit)


AnyEffector = Annotated[
    BodyFrameTable
    | CentroidTable
    | SupportReactionTable
    | BodyAngleTable
    | ActuatorDisplacementTable
    | ActuatorForceTable,
    Field(discriminator="type"),
]


def build_effectors(
    tables: Mapping[str, EffectorTable], mesh: TetMesh, mechanism: Mechanism
) -> Effectors:
    """Build all effectors of a project by name, without measured values.

    Raises:
        WrongKeyError: If one does not fit the mesh, the bodies or the actuators.
    """
    found: Effectors = {}
    for name, table in tables.items():
        with under(name):
            _check_names(table, mechanism)
            dimension, std = table.dimension(mechanism), None
            if table.std is not None:
                with under("std"):
                    std = parse_scalar(table.std, dimension)
            found[name] = table.build(name, std)
            found[name].rows(mesh, mechanism)
    return found


def with_measured(
    effectors: Effectors,
    measured: Mapping[str, Any],
    tables: Mapping[str, EffectorTable],
    folder: Path,
    mechanism: Mechanism,
) -> tuple[AbstractEffector, ...]:
    """Add the measured values of a configuration to its effectors.

    Args:
        effectors: The effectors of the configuration.
        measured: Measured values as the file has them, by effector.
        tables: The tables of the effectors.
        folder: Folder that relative paths start from.
        mechanism: Rigid bodies and actuators.

    Raises:
        WrongKeyError: If a name is unknown, or a value or file is wrong.
    """
    found = dict(effectors)
    for name, value in measured.items():
        with under(name):
            known_name("effector", name, effectors, "effectors")
            own = tables[name].value(value, folder, mechanism)
            found[name] = replace(found[name], measured=own)  # pyright: ignore
    return tuple(found.values())


def _check_names(table: EffectorTable, mechanism: Mechanism) -> None:
    bodies, actuators = mechanism.bodies.names, mechanism.actuators.names
    for key, kind, known, section in (
        ("body", "rigid body", bodies, "bodies"),
        ("other", "rigid body", bodies, "bodies"),
        ("actuator", "actuator", actuators, "actuators"),
    ):
        if key in type(table).model_fields:
            known_name(kind, getattr(table, key), known, section)
