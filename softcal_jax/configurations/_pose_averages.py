"""Means and covariances of repeated readings of a tracker."""

import equinox as eqx
import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations._pose_table import PoseTable

_ONE_POSE = np.deg2rad(30.0)
"""Largest turn of a reading of one pose from the mean of the readings [rad]."""


class AveragedPose(eqx.Module):
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
        """Covariance of the mean if the readings are independent [m, rad].

        Raises:
            ValueError: If there is only one reading.
        """
        return self.reading_covariance / self.n_readings


def average_poses(table: PoseTable) -> dict[str, AveragedPose]:
    """Average the readings of each sensor while it stood still.

    The mean rotation has the least sum of squared matrix distances, by
    `scipy.spatial.transform.Rotation.mean` (Markley et al., J. Guid. Control Dyn. 30,
    2007).

    Args:
        table: Readings of one pose of the robot; of one sensor or several.

    Returns:
        The mean pose by sensor.

    Raises:
        ValueError: If a reading turns by more than 30 degrees from the mean of its
            sensor, so that they are not all of one pose.
    """
    return {
        name: _average(table.readings_of(name)) for name in dict.fromkeys(table.names)
    }


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
