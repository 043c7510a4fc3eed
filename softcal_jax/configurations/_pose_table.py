"""Measured poses: their change of frame, means and covariances."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._module import Module
from softcal_jax._names import suggestion
from softcal_jax._typing import Float, HostArray
from softcal_jax.bodies import Pose

_ONE_POSE = np.deg2rad(30.0)
"""Largest turn of a reading of one pose from the mean of the readings [rad]."""


class PoseTable(Module):
    """Poses of sensors, one row per reading; a sensor may have several.

    A row takes points from the sensor's frame to the table's: x = R x_sensor + p.

    Attributes:
        names: Sensor of each row.
        positions: Origin of the sensor, p [m].
        rotations: Its axes as columns, R [-].
        lines: Line of the file that each row stands on, from 1.
        source: What was read, for messages.
    """

    names: tuple[str, ...]
    positions: Float[HostArray, "n_rows 3"]
    rotations: Float[HostArray, "n_rows 3 3"]
    lines: tuple[int, ...]
    source: str

    def __check_init__(self):
        n = len(self.names)
        shapes = (self.positions.shape, self.rotations.shape, (len(self.lines),))
        if shapes != ((n, 3), (n, 3, 3), (n,)):
            raise ValueError(
                f"{n} names need as many positions, rotations and lines, got the "
                f"shapes {', '.join(map(str, shapes))}."
            )

    def readings_of(self, name: str) -> "PoseTable":
        """Return the rows of one sensor."""
        rows = [i for i, other in enumerate(self.names) if other == name]
        if not rows:
            known = dict.fromkeys(self.names)
            raise ValueError(
                f"{self.source} has no sensor {name!r}.{suggestion(name, known)} "
                f"It has {', '.join(known)}."
            )
        return replace(
            self,
            names=(name,) * len(rows),
            positions=self.positions[rows],
            rotations=self.rotations[rows],
            lines=tuple(self.lines[i] for i in rows),
        )


def in_frame(
    table: PoseTable, *, base: Pose | None = None, sensor: Pose | None = None
) -> PoseTable:
    """Convert poses of a sensor to those of its body, in the frame of the robot.

    T_body = T_base T_reading T_sensor^-1, where a pose stands for the change of
    coordinates x -> R x + translation (a `Pose` whose origin is zero).

    Args:
        table: Readings of sensors with the same place on their body.
        base: Pose of the tracker's base in the robot's frame; by default the same.
        sensor: Pose of the sensor in the body's frame; likewise.
    """
    R, p = table.rotations, table.positions
    if sensor is not None:
        R = R @ sensor.matrix.T
        p = p - R @ sensor.translation
    if base is not None:
        R, p = base.matrix @ R, p @ base.matrix.T + base.translation
    return replace(table, positions=p, rotations=R)


class AveragedPose(Module):
    """Mean of the readings of one sensor.

    A deviation holds three positions and a rotation vector r in the axes of the table:
    reading k has p_k = p + deviation and R_k = exp(r) R. Covariances have its order and
    units: [m2] and [rad2] on the diagonal.

    Attributes:
        name: The sensor.
        position: Mean of the positions, p [m].
        rotation: Mean of the rotations, R [-].
        deviations: Of each reading from the mean [m, rad].
    """

    name: str
    position: Float[HostArray, "3"]
    rotation: Float[HostArray, "3 3"]
    deviations: Float[HostArray, "n_readings 6"]

    @property
    def n_readings(self) -> int:
        """Number of readings."""
        return len(self.deviations)

    @property
    def reading_covariance(self) -> Float[HostArray, "6 6"]:
        """Covariance of a single reading, with n - 1 in the denominator [m, rad].

        Raises:
            ValueError: If there is only one reading.
        """
        if self.n_readings < 2:
            raise ValueError(
                f"sensor {self.name!r} has one reading: a covariance needs two or more."
            )
        return self.deviations.T @ self.deviations / (self.n_readings - 1)

    @property
    def mean_covariance(self) -> Float[HostArray, "6 6"]:
        """Covariance of the mean if the readings are independent [m, rad]."""
        return self.reading_covariance / self.n_readings


def average_poses(table: PoseTable) -> dict[str, AveragedPose]:
    """Average the readings of each sensor, by name, while it stood still.

    The mean rotation has the least sum of squared matrix distances, by
    `scipy.spatial.transform.Rotation.mean` (Markley et al., J. Guid. Control Dyn. 30,
    2007).

    Raises:
        ValueError: If a reading turns by more than 30 degrees from the mean of its
            sensor, so that they are not all of one pose.
    """
    names = dict.fromkeys(table.names)
    return {name: _average(table.readings_of(name)) for name in names}


def _average(readings: PoseTable) -> AveragedPose:
    rotations = Rotation.from_matrix(readings.rotations)
    mean = rotations.mean()
    turns = (rotations * mean.inv()).as_rotvec()
    angles = np.linalg.norm(turns, axis=1)
    worst = int(np.argmax(angles))
    if angles[worst] > _ONE_POSE:
        raise ValueError(
            f"{readings.source}, line {readings.lines[worst]}: this reading of sensor "
            f"{readings.names[0]!r} turns by {np.rad2deg(angles[worst]):.3g} deg from "
            f"the mean of {len(angles)}, more than 30 deg: select the readings of one "
            "pose."
        )
    position = readings.positions.mean(axis=0)
    deviations = np.hstack([readings.positions - position, turns])
    return AveragedPose(readings.names[0], position, mean.as_matrix(), deviations)
