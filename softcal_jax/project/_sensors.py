"""Tables of a project file for the places and readings of 6-D sensors."""

from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray
from softcal_jax.bodies import Pose
from softcal_jax.configurations import (
    PoseTable,
    average_poses,
    in_frame,
    read_polhemus,
    read_poses,
)
from softcal_jax.project._mesh import LengthUnit
from softcal_jax.project._table import (
    Angle,
    Integer,
    Number,
    Position,
    RotationVector,
    Table,
)

Selection = dict[str, str]
"""Values that the selected rows of a file of readings have, by column."""

Delimiter = Literal[",", ";", "\t", "|"]
"""What stands between the columns of a file, where its header does not tell."""

Decimal = Literal[".", ","]
"""What stands before decimals, where the numbers of a file do not tell."""

_UNIT_LENGTH = 1e-3
"""Tolerance on the length of a quaternion, above the rounding of four digits."""


class OrientationTable(Table):
    """An orientation: the angles of a tracker, a quaternion or a rotation vector."""

    azimuth: Angle | None = None
    elevation: Angle | None = None
    roll: Angle | None = None
    quaternion: tuple[Number, Number, Number, Number] | None = None
    rotation_vector: RotationVector | None = None

    @property
    def forms(self) -> list[str]:
        """One key for each form that is given."""
        given = {key for key, value in self if value is not None}
        angles = [key for key in ("azimuth", "elevation", "roll") if key in given]
        return angles[:1] + [k for k in ("quaternion", "rotation_vector") if k in given]

    @model_validator(mode="after")
    def _check_form(self) -> "OrientationTable":
        if len(self.forms) > 1:
            raise ValueError(
                f"got {' and '.join(self.forms)}; give the orientation in one form: "
                "azimuth, elevation and roll, or a quaternion, or a rotation_vector."
            )
        return self

    @property
    def rotation(self) -> Float[HostArray, "3 3"]:
        """Rotation matrix from the frame's own axes to those it is given in [-].

        The angles are those of Polhemus: R = Rz(azimuth) Ry(elevation) Rx(roll).
        """
        if self.quaternion is not None:
            w, *xyz = self.quaternion
            length = float(np.linalg.norm(self.quaternion))
            if not abs(length - 1.0) <= _UNIT_LENGTH:
                raise ValueError(
                    f"quaternion has the length {length:.6g}, not 1: write four digits "
                    "or more, the scalar part first."
                )
            return Rotation.from_quat([*xyz, w]).as_matrix()
        if self.rotation_vector is not None:
            return Rotation.from_rotvec(self.rotation_vector).as_matrix()
        angles = [self.azimuth or 0.0, self.elevation or 0.0, self.roll or 0.0]
        return Rotation.from_euler("ZYX", angles).as_matrix()


class FrameTable(OrientationTable):
    """Position and orientation of a frame, in the frame of the mesh."""

    position: Position = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> Pose:
        """Transformation from the frame's coordinates to those it is given in."""
        return Pose.from_matrix(self.rotation, np.array(self.position))


class MeasuredMotion(NamedTuple):
    """The motion of a rigid body, and what its measurement says of its errors.

    Attributes:
        pose: The motion.
        covariance: Of its translation and of a rotation vector, in the axes of the
            mesh; None where nothing is known of it [m, rad].
    """

    pose: Pose
    covariance: Float[HostArray, "6 6"] | None


class MeasuredPoseTable(OrientationTable):
    """The pose of a 6-D sensor, written out or read from a file."""

    position: Position | None = None
    file: str | None = None
    format: Literal["table", "polhemus"] = "table"
    length_unit: LengthUnit | None = None
    delimiter: Delimiter | None = None
    decimal: Decimal | None = None
    angle_unit: Literal["deg", "rad"] = "deg"
    sensor: str | None = None
    station: Integer | None = None
    select: Selection = Field(default_factory=dict)
    displacement_from: Selection | None = None

    @model_validator(mode="after")
    def _check(self) -> "MeasuredPoseTable":
        given = self.model_fields_set - {"position", *OrientationTable.model_fields}
        if self.file is None:
            if self.position is None:
                raise ValueError(
                    "expected the pose, { position = ..., azimuth = ..., elevation = "
                    '..., roll = ... }, or where it was read, { file = "tracker.csv" }.'
                )
            if given:
                raise ValueError(
                    f"{sorted(given)[0]} belongs to a file, which is not there; add "
                    "`file`."
                )
            return self
        if self.position is not None or self.forms:
            raise ValueError("got a pose and a file; give one of them.")
        of_other = {
            "table": {"station", "angle_unit"},
            "polhemus": {
                *("sensor", "select", "displacement_from", "delimiter", "decimal")
            },
        }
        foreign = sorted(given & of_other[self.format])
        if foreign:
            raise ValueError(
                f'{foreign[0]} does not go with format = "{self.format}": a table has '
                "a header and columns to select by (sensor, select, "
                'displacement_from); "polhemus" is the bare text of a tracker '
                "(station, angle_unit)."
            )
        if self.format == "polhemus" and self.length_unit is None:
            raise ValueError(
                'format = "polhemus" needs length_unit, what the tracker was set to: '
                '"cm" or "inch".'
            )
        return self

    def motion(
        self,
        folder: Path,
        base: FrameTable,
        mounted: OrientationTable,
        rest: Float[HostArray, "3"],
    ) -> MeasuredMotion:
        """Compute the motion of a rigid body from the pose of the sensor on it.

        It is the motion from rest, or with `displacement_from` between two readings, so
        that it does not matter exactly where the sensor was glued.

        Args:
            folder: Folder that relative paths start from.
            base: Frame of the tracker's base.
            mounted: Orientation of the sensor on the mesh at rest.
            rest: Position of the sensor at rest [m].
        """
        position, rotation = self._mean(folder, base, self.select)
        before, mounting = rest, mounted.rotation
        if self.displacement_from is not None:
            earlier = {**self.select, **self.displacement_from}
            before, mounting = self._mean(folder, base, earlier)
        motion = Pose.from_matrix(rotation @ mounting.T, position - before)
        return MeasuredMotion(motion, None)

    def _mean(
        self, folder: Path, base: FrameTable, select: Selection
    ) -> tuple[Float[HostArray, "3"], Float[HostArray, "3 3"]]:
        """Average position [m] and axes of selected readings, in the mesh's frame."""
        readings = in_frame(self._readings(folder, select), base=base.pose)
        names = list(dict.fromkeys(readings.names))
        if self.sensor is None and len(names) > 1:
            raise ValueError(
                f"{readings.source} has the sensors {', '.join(names)}; say which one "
                f'is meant, like sensor = "{names[0]}".'
            )
        name = self.sensor or names[0]
        mean = average_poses(readings.readings_of(name))[name]
        return mean.position, mean.rotation

    def _readings(self, folder: Path, select: Selection) -> PoseTable:
        if self.file is None:
            p, R = np.array([self.position], float), self.rotation[None]
            return PoseTable(("sensor",), p, R, (1,), "the pose")
        path = folder / self.file
        if self.format == "table":
            dialect = {"delimiter": self.delimiter, "decimal": self.decimal}
            return read_poses(
                path, length_unit=self.length_unit, select=select, **dialect
            )
        station = self.station
        return read_polhemus(
            path,
            length_unit=str(self.length_unit),
            angle_unit=self.angle_unit,
            stations=None if station is None else {station: f"station {station}"},
        )
