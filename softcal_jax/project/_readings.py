"""What a 6-D sensor measured: a pose in the project file or a file of readings."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.bodies import Pose
from softcal_jax.configurations import (
    PoseTable,
    average_poses,
    in_frame,
    read_polhemus,
    read_poses,
)
from softcal_jax.project._orientation import frame_of, rotation_of
from softcal_jax.project._schema_effectors import EffectorTable, MeasuredPoseTable


class SensorPose(NamedTuple):
    """Where a sensor is, in the frame of the mesh.

    Attributes:
        position: Its origin [m].
        rotation: Its axes as columns [-].
    """

    position: Float[HostArray, "3"]
    rotation: Float[HostArray, "3 3"]


def measured_motion(
    folder: Path,
    effector: EffectorTable,
    table: MeasuredPoseTable,
    rest: Float[HostArray, "3"],
) -> Pose:
    """Motion of a rigid body from rest, by the pose of the sensor on it.

    With `displacement_from`, the motion between the two readings, so that where exactly
    the sensor was glued does not matter.

    Args:
        folder: Where relative paths begin.
        effector: The effector, which knows the tracker's base and the sensor's place.
        table: The measurement.
        rest: Where the sensor is on the mesh at rest [m].

    Returns:
        Translation of the point `rest` [m], and rotation.

    Raises:
        ValueError: If a file or value is wrong, or readings are not of one pose.
    """
    read = lambda select: _pose(folder, effector, table, select)
    now = read(table.select)
    then = SensorPose(rest, rotation_of(effector.orientation))
    if table.displacement_from is not None:
        then = read({**table.select, **table.displacement_from})
    return Pose.from_matrix(
        now.rotation @ then.rotation.T, now.position - then.position
    )


def _pose(
    folder: Path,
    effector: EffectorTable,
    table: MeasuredPoseTable,
    select: dict[str, str],
) -> SensorPose:
    """The mean pose of the selected readings, in the frame of the mesh."""
    readings = in_frame(_table(folder, table, select), base=frame_of(effector.base))
    names = list(dict.fromkeys(readings.names))
    if table.sensor is None and len(names) > 1:
        raise ValueError(
            f"{readings.source} has the sensors {', '.join(names)}; say which one is "
            f'meant, like sensor = "{names[0]}".'
        )
    name = table.sensor or names[0]
    mean = average_poses(readings.readings_of(name))[name]
    return SensorPose(mean.position, mean.rotation)


def _table(folder: Path, table: MeasuredPoseTable, select: dict[str, str]) -> PoseTable:
    if table.file is None:
        return PoseTable(
            ("sensor",),
            np.array([table.position], float),
            rotation_of(table)[None],
            (1,),
            "the pose",
        )
    path = folder / table.file
    if table.format == "table":
        return read_poses(path, length_unit=table.length_unit, select=select)
    station = table.station
    return read_polhemus(
        path,
        length_unit=str(table.length_unit),
        angle_unit=table.angle_unit,
        stations=None if station is None else {station: f"station {station}"},
    )
