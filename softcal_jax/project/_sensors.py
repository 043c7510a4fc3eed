"""Tables of a project file for effectors, 6-D sensors and printed tags."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, StrictFloat, StrictInt, model_validator
from scipy.spatial.transform import Rotation

from softcal_jax import configurations
from softcal_jax._typing import Float, HostArray
from softcal_jax.bodies import Pose
from softcal_jax.configurations import (
    AbstractEffector,
    BodyFrame,
    Mechanism,
    Unstated,
)
from softcal_jax.equilibrium import Model
from softcal_jax.exchange.camera import find_photos, tag_pose
from softcal_jax.mesh import TetMesh
from softcal_jax.project import _quantities as typed
from softcal_jax.project._quantities import (
    dimension_of,
    parse_in_si,
    parse_vector,
    shown,
)
from softcal_jax.project._robot import LengthUnit
from softcal_jax.project._table import (
    Choice,
    File,
    Maker,
    Table,
    of_type,
    table_of,
    under,
)
from softcal_jax.readings import (
    PoseTable,
    from_quaternion,
    read_polhemus,
    read_poses,
)

Selection = dict[str, str]
"""Values that the selected rows of a file of readings have, by column."""


class DialectTable(Table):
    """How the numbers of a file are written, where the file does not say it."""

    length_unit: LengthUnit | None = None
    delimiter: Literal[",", ";", "\t", "|"] | None = None
    decimal: Literal[".", ","] | None = None

    @property
    def dialect(self) -> dict[str, Any]:
        """These keys, as arguments of the function that reads the file."""
        return self.model_dump(include=set(DialectTable.model_fields))


class OrientationTable(Table):
    """An orientation: the angles of a tracker, a quaternion or a rotation vector."""

    azimuth: typed.Angle | None = None
    elevation: typed.Angle | None = None
    roll: typed.Angle | None = None
    quaternion: tuple[StrictFloat, StrictFloat, StrictFloat, StrictFloat] | None = None
    rotation_vector: typed.RotationVector | None = None

    @model_validator(mode="after")
    def _check_form(self) -> "OrientationTable":
        given = {key for key, value in self if value is not None}
        angles = [key for key in ("azimuth", "elevation", "roll") if key in given]
        forms = angles[:1] + sorted(given & {"quaternion", "rotation_vector"})
        if len(forms) > 1:
            raise ValueError(
                f"got {' and '.join(forms)}; give the orientation in one form: "
                "azimuth, elevation and roll, or a quaternion, or a rotation_vector."
            )
        return self

    @property
    def rotation(self) -> Float[HostArray, "3 3"]:
        """Rotation matrix from the frame's axes to those it is given in [-].

        The angles are those of Polhemus: R = Rz(azimuth) Ry(elevation) Rx(roll).
        """
        if self.quaternion is not None:
            return from_quaternion(self.quaternion)
        if self.rotation_vector is not None:
            return Rotation.from_rotvec(self.rotation_vector).as_matrix()
        angles = [self.azimuth or 0.0, self.elevation or 0.0, self.roll or 0.0]
        return Rotation.from_euler("ZYX", angles).as_matrix()


class FrameTable(OrientationTable):
    """Position and orientation of a frame, in the frame of the mesh."""

    position: typed.Position = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> Pose:
        """Transformation from the frame's coordinates to those it is given in."""
        return Pose.from_matrix(self.rotation, np.array(self.position))


Seen = tuple[Pose, Float[HostArray, "6 6"] | None]
"""A pose or a motion in the frame of the mesh, and the covariance of its translation
and of a rotation vector in the axes of the mesh [m, rad]; None where it is not known.
"""


class MotionSource(Table):
    """What the motion of a rigid body is found from: poses of a sensor or of a tag."""

    @abstractmethod
    def seen(self, base: Pose) -> Seen:
        """Return the pose."""

    def seen_before(self, base: Pose) -> Seen | None:
        """Return the pose that displacements start from; None for rest."""

    def motion(
        self, base: Pose, mounted: OrientationTable, rest: Float[HostArray, "3"]
    ) -> Seen:
        """Compute the motion of a rigid body, from rest or from an earlier pose.

        The `base` is the frame of the tracker's base, or of the base tag. At rest, the
        sensor or tag stands at `rest` [m] and is `mounted` on the mesh; with an earlier
        pose it does not matter exactly where it was glued.
        """
        pose, covariance = self.seen(base)
        before, mounting, earlier = rest, mounted.rotation, None
        if (start := self.seen_before(base)) is not None:
            before, mounting, earlier = start[0].translation, start[0].matrix, start[1]
        turn = pose.matrix @ mounting.T
        if covariance is not None and earlier is not None:
            # Turned by the motion: exp(r) R (exp(s) S)^T = exp(r - R S^T s) R S^T.
            change = np.eye(6)
            change[3:, 3:] = turn
            covariance = covariance + change @ earlier @ change.T
        return Pose.from_matrix(turn, pose.translation - before), covariance


def _mean(readings: PoseTable, base: Pose) -> Seen:
    """Average the pose of one sensor in the mesh's frame."""
    means = readings.in_frame(base).means()
    if len(means) > 1:
        raise ValueError(
            f"{readings.source} has the sensors {', '.join(means)}; say which one is "
            f"meant, by `sensor` or `station`."
        )
    (mean,) = means.values()
    return mean, None


class WrittenPoseTable(MotionSource, OrientationTable):
    position: typed.Position = Field(
        description='the pose, { position = "(0, 0, 100) mm", azimuth = "10 deg" }, or '
        'where it was read, { file = "tracker.csv" }'
    )

    def seen(self, base: Pose) -> Seen:
        p, R = np.array([self.position], float), self.rotation[None]
        return _mean(PoseTable(("sensor",), p, R, (1,), "the pose"), base)


class PoseFileTable(MotionSource, DialectTable):
    """A table of poses, with a header and columns to select by."""

    file: File
    format: Literal["table"] = "table"
    sensor: str | None = None
    select: Selection = Field(default_factory=dict)
    displacement_from: Selection | None = None

    def seen(self, base: Pose) -> Seen:
        rows = read_poses(self.file, select=self.select, **self.dialect)
        one = rows if self.sensor is None else rows.readings_of(self.sensor)
        return _mean(one, base)

    def seen_before(self, base: Pose) -> Seen | None:
        if self.displacement_from is None:
            return None
        select = self.select | self.displacement_from
        return self.model_copy(update={"select": select}).seen(base)


class PolhemusFileTable(MotionSource):
    """The bare text of a tracker."""

    file: File
    format: Literal["polhemus"]
    length_unit: LengthUnit = Field(description='unit of the tracker: "cm" or "inch"')
    angle_unit: Literal["deg", "rad"] = "deg"
    station: StrictInt | None = None

    def seen(self, base: Pose) -> Seen:
        options = self.model_dump(include={"length_unit", "angle_unit", "station"})
        return _mean(read_polhemus(self.file, **options), base)


def _found(patterns: tuple[str, ...], info: Any) -> Any:
    try:
        return find_photos(patterns, info.context.folder)
    except FileNotFoundError as error:
        raise ValueError(str(error)) from error


Photos = Annotated[typed.Names, AfterValidator(_found)]
"""Photographs by patterns like "pose1/*.jpg"; as read, the files that fit."""


class EarlierPhotosTable(Table):
    photos: Photos = Field(description='photographs: "rest/*.jpg"')


class PhotosTable(MotionSource):
    """The pose of a tag on a rigid body, from photographs of it and of a base tag.

    `base` of the effector is the frame of the base tag, and `orientation` that of the
    tag on the mesh at rest. `board` are photographs of the printed board, by which the
    camera is calibrated.
    """

    photos: Photos = Field(description='photographs: "pose1/*.jpg"', min_length=1)
    tag: StrictInt = Field(description="number of the tag on the rigid body: 3")
    base_tag: StrictInt = Field(description="number of the tag on the base: 0")
    size: typed.PositiveLength = Field(description='side of the black square: "20 mm"')
    base_size: typed.PositiveLength | None = None
    board: Photos = ()
    displacement_from: EarlierPhotosTable | None = None

    def seen(self, base: Pose) -> Seen:
        tag = tag_pose(**{k: v for k, v in self if k != "displacement_from"})
        turn, axes = base.matrix, np.kron(np.eye(2), base.matrix)
        position = turn @ tag.position + base.translation
        pose = Pose.from_matrix(turn @ tag.rotation, position)
        return pose, axes @ tag.covariance @ axes.T

    def seen_before(self, base: Pose) -> Seen | None:
        if self.displacement_from is None:
            return None
        photos = self.displacement_from.photos
        return self.model_copy(update={"photos": photos}).seen(base)


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


class EffectorTable(Maker):
    """Something measured beside markers, with `std` in the unit that it has there."""

    def build(self, name: str, mesh: TetMesh, mechanism: Mechanism) -> AbstractEffector:
        """Build the effector without a measured value, and check that it fits."""
        given = self.arguments()
        std = given.pop("std")
        effector: Any = self.makes(name, **given)
        unit = effector.rows(mesh, mechanism)[0].record.unit
        if not isinstance(std, str):
            return effector
        with under("std"):
            return replace(effector, std=parse_in_si(std, unit, "positive"))

    def measured(self, effector: Any, value: Any, model: Model) -> AbstractEffector:
        """Return the effector with its measured value."""
        row = effector.rows(model.mesh, model.mechanism)[0].record
        dimension = dimension_of(row.unit)
        if isinstance(value, MotionSource):
            raise ValueError(f'expected {dimension.name}, like "{dimension.example}".')
        if row.n_values == 1:
            return replace(effector, measured=parse_in_si(value, row.unit))
        return replace(effector, measured=np.array(parse_vector(value, row.unit)))


class BodyFrameTable(EffectorTable):
    """A frame with the mounting of its sensor, and the frame of the tracker's base."""

    orientation: OrientationTable = OrientationTable()
    base: FrameTable = FrameTable()

    def measured(self, effector: BodyFrame, value: Any, model: Model) -> BodyFrame:
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
        rest = effector.point
        if rest is None:
            rest = bodies.origin[bodies.names.index(effector.body)]
        pose, covariance = value.motion(self.base.pose, self.orientation, rest)
        if covariance is None:
            return replace(effector, measured=pose)
        std, std_angle = np.sqrt(np.diag(covariance)).reshape(2, 3)
        if not isinstance(effector.std, Unstated):
            std = np.hypot(effector.std, std)
        if not isinstance(effector.std_angle, Unstated):
            std_angle = np.hypot(effector.std_angle, std_angle)
        return replace(effector, measured=pose, std=std, std_angle=std_angle)


def _table(kind: type[AbstractEffector]) -> type[Maker]:
    base = BodyFrameTable if kind is BodyFrame else EffectorTable
    return table_of(kind, "name", "measured", base=base, type=str, std=str)


AnyEffector = Annotated[EffectorTable, of_type(configurations.EFFECTORS, _table)]


def build_effectors(
    tables: Mapping[str, EffectorTable], mesh: TetMesh, mechanism: Mechanism
) -> Effectors:
    """Build all effectors of a project by name, without measured values."""
    effectors: Effectors = {}
    for name, table in tables.items():
        with under(name):
            effectors[name] = table.build(name, mesh, mechanism)
    return effectors
