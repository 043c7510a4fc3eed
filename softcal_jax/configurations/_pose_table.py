"""Measured poses: their change of frame, and means."""

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


def in_frame(table: PoseTable, base: Pose) -> PoseTable:
    """Convert readings from the frame of the tracker's base to that of the robot.

    T = T_base T_reading, where a pose stands for x -> R x + translation.

    Args:
        table: Readings of sensors.
        base: Pose of the tracker's base in the robot's frame.
    """
    return replace(
        table,
        positions=table.positions @ base.matrix.T + base.translation,
        rotations=base.matrix @ table.rotations,
    )


class AveragedPose(Module):
    """Mean of the readings of one sensor.

    Attributes:
        position: Mean of the positions [m].
        rotation: Mean of the rotations [-].
    """

    position: Float[HostArray, "3"]
    rotation: Float[HostArray, "3 3"]


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
    return AveragedPose(readings.positions.mean(axis=0), mean.as_matrix())
