"""Measured poses, and their change of frame."""

from dataclasses import replace

import equinox as eqx

from softcal_jax._names import suggestion
from softcal_jax._typing import Float, HostArray
from softcal_jax.bodies import Pose


class PoseTable(eqx.Module):
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
        """Return the rows of one sensor.

        Raises:
            ValueError: If the sensor is not in the table.
        """
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
        base: Pose of the tracker's base in the robot's frame. By default both frames
            are the same.
        sensor: Pose of the sensor in the body's frame; likewise.

    Returns:
        The table with the body's origin and axes in place of the sensor's.
    """
    R, p = table.rotations, table.positions
    if sensor is not None:
        R = R @ sensor.matrix.T
        p = p - R @ sensor.translation
    if base is not None:
        R, p = base.matrix @ R, p @ base.matrix.T + base.translation
    return replace(table, positions=p, rotations=R)
