"""Tables of a project file that make effectors and their measured values.

To add an effector, write one table.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from softcal_jax import configurations
from softcal_jax.configurations import AbstractEffector, BodyFrame, Mechanism, Unstated
from softcal_jax.equilibrium import Model
from softcal_jax.mesh import TetMesh
from softcal_jax.project import _quantities as typed
from softcal_jax.project._problems import under
from softcal_jax.project._quantities import (
    dimension_of,
    parse_scalar,
    parse_vector,
    scalar,
    shown,
)
from softcal_jax.project._sensors import (
    FrameTable,
    MotionSource,
    OrientationTable,
    PhotosTable,
    PolhemusFileTable,
    PoseFileTable,
    WrittenPoseTable,
)
from softcal_jax.project._table import Choice, Table, by_type

Effectors = dict[str, AbstractEffector]


def _measured(value: Any, kinds: Sequence[Any]) -> Any:
    if not isinstance(value, dict):
        return Any
    if "photos" in value:
        return PhotosTable
    if "file" not in value:
        return WrittenPoseTable
    return PolhemusFileTable if value.get("format") == "polhemus" else PoseFileTable


Measured = Annotated[Any, Choice(_measured)]
"""A pose, or a quantity as text, whose dimension the effector knows."""

Body = Annotated[str, Field(description='name of a rigid body, [bodies.NAME]: "plate"')]
Group = Annotated[
    str,
    Field(
        description='name of a group of the mesh: "x_min"', serialization_alias="where"
    ),
]


class EffectorTable(Table):
    """Something measured beside markers; `std` defaults to that of its class.

    Keys except `type` and `std` are arguments of the class that it `makes`.
    """

    makes: ClassVar[type[AbstractEffector]]

    std: str | None = None

    def build(self, name: str, mesh: TetMesh, mechanism: Mechanism) -> AbstractEffector:
        """Build the effector without a measured value, and check that it fits."""
        others = {"type", "std"}
        given = self.model_dump(exclude=others, exclude_none=True, by_alias=True)
        effector: Any = self.makes(name, **given)
        unit = effector.rows(mesh, mechanism)[0].unit
        if self.std is None:
            return effector
        with under("std"):
            std = scalar(dimension_of(unit), "positive")(self.std)
        return replace(effector, std=std)

    def measured(
        self, effector: Any, value: Any, folder: Path, model: Model
    ) -> AbstractEffector:
        """Return the effector with its measured value; paths start from `folder`."""
        row = effector.rows(model.mesh, model.mechanism)[0]
        dimension = dimension_of(row.unit)
        if isinstance(value, MotionSource):
            raise ValueError(f'expected {dimension.name}, like "{dimension.example}".')
        if row.n_values == 1:
            return replace(effector, measured=parse_scalar(value, dimension))
        return replace(effector, measured=np.array(parse_vector(value, dimension)))


class BodyFrameTable(EffectorTable):
    makes = BodyFrame
    type: Literal["frame"]
    body: Body
    point: typed.Position | None = None
    orientation: OrientationTable = Field(OrientationTable(), exclude=True)
    base: FrameTable = Field(FrameTable(), exclude=True)
    std_angle: typed.Angle | None = None

    def measured(
        self, effector: BodyFrame, value: Any, folder: Path, model: Model
    ) -> BodyFrame:
        """Return the frame with the motion of its body.

        Where the measurement has a covariance, it adds to the stated deviations.
        """
        if not isinstance(value, MotionSource):
            raise ValueError(
                f"got {shown(value)}; expected a pose, like "
                '{ position = "(0, 0, 100) mm", azimuth = "10 deg" }, '
                '{ file = "tracker.csv" } or { photos = "pose1/*.jpg", ... }.'
            )
        bodies = model.mechanism.bodies
        rest = bodies.origin[bodies.names.index(self.body)]
        if self.point is not None:
            rest = np.array(self.point)
        pose, covariance = value.motion(folder, self.base.pose, self.orientation, rest)
        if covariance is None:
            return replace(effector, measured=pose)
        std, std_angle = np.sqrt(np.diag(covariance)).reshape(2, 3)
        if not isinstance(effector.std, Unstated):
            std = np.hypot(effector.std, std)
        if not isinstance(effector.std_angle, Unstated):
            std_angle = np.hypot(effector.std_angle, std_angle)
        return replace(effector, measured=pose, std=std, std_angle=std_angle)


class CentroidTable(EffectorTable):
    makes = configurations.Centroid
    type: Literal["centroid"]
    group: Group


class SupportReactionTable(EffectorTable):
    makes = configurations.SupportReaction
    type: Literal["reaction"]
    group: Group


class _OnObstacle(EffectorTable):
    body: str = Field(description='an obstacle, [bodies.NAME] with a shape: "probe"')
    axis: typed.Direction | None = None


class ContactForceTable(_OnObstacle):
    makes = configurations.ContactForce
    type: Literal["contact-force"]


class ContactMomentTable(_OnObstacle):
    makes = configurations.ContactMoment
    type: Literal["contact-moment"]


class BodyAngleTable(EffectorTable):
    makes = configurations.BodyAngle
    type: Literal["angle"]
    body: Body
    other: str = Field(description="the rigid body it is measured from")
    axis: typed.Direction = Field(
        description='axis of the angle, fixed on `other`: "z", or [0, 0, 1]'
    )


class _OfActuator(EffectorTable):
    actuator: str = Field(description='name of an actuator, [actuators.NAME]: "cable"')
    std: str | None = Field(
        description='standard deviation, with the unit of what is measured: "0.1 mm"'
    )


class ActuatorDisplacementTable(_OfActuator):
    makes = configurations.ActuatorDisplacement
    type: Literal["actuator-displacement"]


class ActuatorForceTable(_OfActuator):
    makes = configurations.ActuatorForce
    type: Literal["actuator-force"]


AnyEffector = Annotated[EffectorTable, Choice(by_type)]


def build_effectors(
    tables: Mapping[str, EffectorTable], mesh: TetMesh, mechanism: Mechanism
) -> Effectors:
    """Build all effectors of a project by name, without measured values."""
    effectors: Effectors = {}
    for name, table in tables.items():
        with under(name):
            effectors[name] = table.build(name, mesh, mechanism)
    return effectors
