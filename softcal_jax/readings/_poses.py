"""Frames: poses of the sensors of a 6-D tracker, and that of the cameras."""

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import ArrayLike
from scipy.spatial.transform import Rotation

from softcal_jax._module import Module
from softcal_jax._text import check_known, shortened, suggestion
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import METRES
from softcal_jax.bodies import Pose
from softcal_jax.readings._table import (
    CsvTable,
    TrackerWarning,
    at_line,
    parse_number,
    read_lines,
    read_table,
)

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
        """Return the readings of one sensor.

        Raises:
            ValueError: If there are none.
        """
        rows = [i for i, other in enumerate(self.names) if other == name]
        if not rows:
            known = dict.fromkeys(self.names)
            raise ValueError(
                f"{self.source} has no sensor {name!r}.{suggestion(name, known)} "
                f"It has {', '.join(known)}."
            )
        names, lines = (name,) * len(rows), tuple(self.lines[i] for i in rows)
        positions, rotations = self.positions[rows], self.rotations[rows]
        return PoseTable(names, positions, rotations, lines, self.source)

    def in_frame(self, base: Pose) -> "PoseTable":
        """Convert readings from the frame of the tracker's base to that of the robot.

        T = T_base T_reading, where the pose of the base in the robot's frame stands for
        x -> R x + translation.
        """
        positions = self.positions @ base.matrix.T + base.translation
        return replace(
            self, positions=positions, rotations=base.matrix @ self.rotations
        )

    def means(self) -> dict[str, Pose]:
        """Average the readings of each sensor, by name, while it stood still.

        A pose stands for x = R x_sensor + translation. The mean rotation has the least
        sum of squared matrix distances, by `scipy.spatial.transform.Rotation.mean`
        (Markley et al., J. Guid. Control Dyn. 30, 2007).

        Raises:
            ValueError: If a reading turns by more than 30 degrees from the mean of its
                sensor, so that they are not all of one pose.
        """
        poses = {}
        for name in dict.fromkeys(self.names):
            readings = self.readings_of(name)
            rotations = Rotation.from_matrix(readings.rotations)
            mean = rotations.mean()
            angles = (rotations * mean.inv()).magnitude()
            worst = int(np.argmax(angles))
            if angles[worst] > _ONE_POSE:
                raise ValueError(
                    f"{self.source}, line {readings.lines[worst]}: this reading of "
                    f"sensor {name!r} turns by {np.rad2deg(angles[worst]):.3g} deg "
                    f"from the mean of {len(angles)}, more than 30 deg: select the "
                    "readings of one pose."
                )
            poses[name] = Pose(readings.positions.mean(axis=0), mean.as_rotvec())
        return poses


_QUATERNION = ["qw", "qx", "qy", "qz"]
_ANGLES = ("azimuth", "elevation", "roll")
_RADIANS = {"deg": np.pi / 180.0, "rad": 1.0}

_UNIT_LENGTH = 1e-3
"""Largest error of a quaternion's length, more than rounding to four digits gives."""


def read_poses(
    path: str | os.PathLike[str],
    *,
    length_unit: str | None = None,
    select: Mapping[str, str] | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> PoseTable:
    """Read poses of sensors, in their order, from a CSV file with a header line.

    Columns: `sensor`; positions, other columns and arguments as for `read_markers`; and
    either the angles `azimuth_deg`, `elevation_deg`, `roll_deg` (or `..._rad`) or a
    unit quaternion `qw`, `qx`, `qy`, `qz`. The angles are those of Polhemus:
    R = Rz(azimuth) Ry(elevation) Rx(roll), to the axes of the tracker's base.

    Raises:
        ValueError: As for `read_markers`, or if an angle is out of its range or a
            quaternion is not of unit length.

    Warns:
        TrackerWarning: If angles in degrees look like radians.
    """
    table = read_table(path, "sensor", select, delimiter=delimiter, decimal=decimal)
    columns, metres = table.coordinates(length_unit)
    turn_columns = _turn_columns(table)
    lines, values = table.lines, table.numbers(columns + turn_columns, gaps=False)
    points, turns = metres * values[:, :3], values[:, 3:]
    if turn_columns == _QUATERNION:
        rotations = np.empty((len(turns), 3, 3))
        for i, line in enumerate(lines):
            with at_line(table.source, line):
                rotations[i] = from_quaternion(turns[i])
    else:
        unit = turn_columns[0].removeprefix("azimuth_")
        rotations = _from_angles(table.source, lines, turns, unit)
    return PoseTable(table.names, points, rotations, lines, table.source)


def read_polhemus(
    path: str | os.PathLike[str],
    *,
    length_unit: str,
    angle_unit: str = "deg",
    station: int | None = None,
) -> PoseTable:
    """Read the text that a Polhemus tracker sends: numbers without a header.

    Each line holds seven numbers with spaces between: station, x, y, z, azimuth,
    elevation, roll; see `read_poses` for the angles. Units of length and of angles
    ("deg" or "rad") are those that the tracker was set to. Lines that start with `#`
    and blank lines are skipped. Names of sensors are like "station 1"; with a `station`
    only that one is read.

    Raises:
        ValueError: If a unit is unknown, a line does not hold seven finite numbers, the
            station is not there, or an angle is out of its range.

    Warns:
        TrackerWarning: As for `read_poses`.
    """
    check_known("length unit", METRES, length_unit)
    check_known("angle unit", _RADIANS, angle_unit)
    path = Path(path)
    readings = [
        (line, _seven_numbers(path, line, text))
        for line, text in read_lines(path, "tracker")
    ]
    chosen = [(n, v) for n, v in readings if station is None or v[0] == station]
    if not chosen:
        present = dict.fromkeys(f"{values[0]:.0f}" for _, values in readings)
        wanted = "readings" if station is None else f"station {station}"
        raise ValueError(
            f"{path} has no {wanted}. Stations: {', '.join(present) or 'none'}."
        )
    lines = tuple(line for line, _ in chosen)
    values = np.array([v for _, v in chosen])
    return PoseTable(
        names=tuple(f"station {number:.0f}" for number in values[:, 0]),
        positions=METRES[length_unit] * values[:, 1:4],
        rotations=_from_angles(str(path), lines, values[:, 4:], angle_unit),
        lines=lines,
        source=str(path),
    )


def _turn_columns(table: CsvTable) -> list[str]:
    header = table.header
    forms = [[f"{angle}_{unit}" for angle in _ANGLES] for unit in _RADIANS]
    kinds = [form for form in (_QUATERNION, *forms) if set(form) & set(header)]
    if len(kinds) != 1:
        raise ValueError(
            f"{table.source}: it has the rotation with a unit in {len(kinds)} forms, "
            "expected one: the columns azimuth_deg, elevation_deg, roll_deg (or "
            f"azimuth_rad, ...) or qw, qx, qy, qz. Columns there: {', '.join(header)}."
        )
    return kinds[0]


def _seven_numbers(path: Path, line: int, text: str) -> list[float]:
    try:
        values = [parse_number(cell, ".") for cell in text.split()]
    except ValueError:
        values = []
    if len(values) != 7 or not np.all(np.isfinite(values)) or values[0] % 1.0:
        raise ValueError(
            f"{path}, line {line}: got {shortened(text)!r}; expected 7 finite numbers: "
            "an integer station, x, y, z, azimuth, elevation, roll."
        )
    return values


def from_quaternion(
    quaternion: Sequence[float] | Float[HostArray, "4"],
) -> Float[HostArray, "3 3"]:
    """Convert a quaternion, scalar part first, to a rotation matrix [-].

    Raises:
        ValueError: If it is not of unit length.
    """
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) <= _UNIT_LENGTH:
        raise ValueError(
            f"the quaternion has the length {length:.6g}, not 1: write four digits or "
            "more, the scalar part first, and neither scale nor average quaternions."
        )
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def _from_angles(
    source: str, lines: tuple[int, ...], angles: Float[HostArray, "n 3"], unit: str
) -> Float[HostArray, "n 3 3"]:
    """Compute rotation matrices Rz(azimuth) Ry(elevation) Rx(roll) [-]."""
    # With some tolerance, since trackers print few digits: 1.571 is a right angle.
    limits = np.array([2.0 * np.pi, np.pi / 2.0, 2.0 * np.pi]) / _RADIANS[unit]
    outside = np.argwhere(np.abs(angles) > 1.001 * limits)
    if outside.size:
        row, k = outside[0]
        raise ValueError(
            f"{source}, line {lines[row]}: the {_ANGLES[k]} is {angles[row, k]:g} "
            f"{unit}, beyond {limits[k]:.4g} {unit}: check the unit of the angles, "
            "angle_unit or columns like azimuth_deg."
        )
    # Numbers that could all be radians, and are too large to ignore.
    sizes = np.abs(angles).max(axis=0)
    if unit == "deg" and all(sizes <= [3.142, 1.571, 3.142]) and sizes.max() > 1.0:
        warnings.warn(
            f"{source}: every angle lies within half a turn if it is in radians. If "
            "they are not degrees, say so by angle_unit or columns like azimuth_rad.",
            TrackerWarning,
            stacklevel=3,
        )
    return Rotation.from_euler("ZYX", angles * _RADIANS[unit]).as_matrix()


class Registration(Module):
    """A rigid motion fitted to markers that are known in both frames.

    Attributes:
        rotation: Rotation matrix, camera axes to mesh axes [-].
        translation: Translation after the rotation [m].
        residuals: Residual of each marker used, in the mesh frame [m].
    """

    rotation: Float[HostArray, "3 3"]
    translation: Float[HostArray, "3"]
    residuals: Float[HostArray, "n_used 3"]

    @property
    def rms(self) -> float:
        """Root mean square of the residual distances [m]."""
        return float(np.sqrt(np.mean(np.sum(self.residuals**2, axis=1))))

    def apply(self, points: Float[ArrayLike, "n 3"]) -> Float[HostArray, "n 3"]:
        """Move points from the camera frame to the mesh frame [m]."""
        return np.asarray(points, float) @ self.rotation.T + self.translation


def register(
    measured: Float[ArrayLike, "n_markers 3"],
    nominal: Float[ArrayLike, "n_markers 3"],
    *,
    rotation: Float[ArrayLike, "3 3"] | None = None,
) -> Registration:
    """Fit the rigid motion that takes measured markers onto nominal positions.

    The least-squares rotation of Kabsch (Acta Cryst. A32, 1976), by
    `scipy.spatial.transform.Rotation.align_vectors`. Positions are `measured` in the
    camera frame and `nominal` in the mesh frame [m]. With a known `rotation`, camera
    axes to mesh axes, one marker is enough [-].

    Raises:
        ValueError: If there are not three finite markers in both that span a triangle,
            or not one where the rotation is known.
    """
    measured, nominal = np.asarray(measured, float), np.asarray(nominal, float)
    if measured.shape != nominal.shape or measured.ndim != 2 or measured.shape[1] != 3:
        raise ValueError(
            "registration needs as many measured as nominal markers, shape "
            f"(n, 3) each [m], got {measured.shape} and {nominal.shape}."
        )
    least = 3 if rotation is None else 1
    if len(measured) < least or not np.all(np.isfinite([measured, nominal])):
        raise ValueError(
            f"registration needs at least {least} finite markers, got {len(measured)}."
        )
    R = _rotation_onto(measured, nominal) if rotation is None else np.asarray(rotation)
    t = nominal.mean(axis=0) - R @ measured.mean(axis=0)
    return Registration(R, t, measured @ R.T + t - nominal)


def _rotation_onto(measured, nominal) -> Float[HostArray, "3 3"]:
    """Fit the rotation; the markers must span a triangle."""
    for kind, points in (("measured", measured), ("nominal", nominal)):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        # Far from the origin, rounding spreads even points that coincide.
        if spread[1] <= max(1e-6 * spread[0], 1e-12 * np.abs(points).max()):
            raise ValueError(
                f"the {kind} markers of the registration lie on a line, which leaves a "
                "rotation free: choose at least three that span a triangle."
            )
    about = [points - points.mean(axis=0) for points in (nominal, measured)]
    turn, *_ = Rotation.align_vectors(*about)
    return turn.as_matrix()
