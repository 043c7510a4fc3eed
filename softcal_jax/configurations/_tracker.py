"""Poses of the sensors of a 6-D tracker from its text export."""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from softcal_jax._names import METRES, unknown_name
from softcal_jax.configurations._csv_table import (
    CsvTable,
    Row,
    check_length_unit,
    coordinates,
    missing,
    read_lines,
    read_table,
)
from softcal_jax.configurations._pose_table import PoseTable
from softcal_jax.configurations._turns import (
    ANGLES,
    RADIANS,
    from_angles,
    from_quaternions,
)

_QUATERNION = ("qw", "qx", "qy", "qz")


def read_poses(
    path: str | os.PathLike[str],
    *,
    length_unit: str | None = None,
    select: Mapping[str, str] | None = None,
) -> PoseTable:
    """Read poses of sensors from a CSV file with a header line.

    Columns: `sensor`; `x`, `y`, `z` or columns that carry their unit, like `x_mm`; and
    either the angles `azimuth_deg`, `elevation_deg`, `roll_deg` (or `..._rad`) or a
    unit quaternion `qw`, `qx`, `qy`, `qz`. Any other column can be selected on. Lines
    that start with `#` and blank lines are skipped.

    The angles are those of Polhemus: R = Rz(azimuth) Ry(elevation) Rx(roll), from the
    sensor's axes to those of the tracker's base.

    Args:
        path: The file.
        length_unit: Unit of the positions: "m", "cm", "mm", "um" or "inch"; not needed
            where the columns carry it.
        select: Column and value pairs; only the rows that have them all are taken.

    Returns:
        The selected readings, in the order of the file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it cannot be read, a column is missing, a unit is unknown,
            unstated or contradicts the columns, nothing is selected, a value is not a
            finite number, an angle is out of its range, or a quaternion is not of unit
            length.

    Warns:
        TrackerWarning: If angles in degrees look like radians.
    """
    table = read_table(path, "sensor", select)
    columns, metres = coordinates(table, length_unit)
    turn_columns = _turn_columns(table)
    values = np.array(
        [
            [_finite(table, row, c) for c in (*columns, *turn_columns)]
            for row in table.rows
        ]
    )
    lines = tuple(row.line for row in table.rows)
    positions, turns = metres * values[:, :3], values[:, 3:]
    if turn_columns == list(_QUATERNION):
        rotations = from_quaternions(table.path, lines, turns)
    else:
        remedy = "name the columns azimuth_{unit}, elevation_{unit}, roll_{unit}"
        unit = turn_columns[0].removeprefix("azimuth_")
        rotations = from_angles(table.path, lines, turns, unit=unit, remedy=remedy)
    names = tuple(row.cells["sensor"] for row in table.rows)
    return PoseTable(
        names=names,
        positions=positions,
        rotations=rotations,
        lines=lines,
        source=table.source,
    )


def read_polhemus(
    path: str | os.PathLike[str],
    *,
    length_unit: str,
    angle_unit: str = "deg",
    stations: Mapping[int, str] | None = None,
) -> PoseTable:
    """Read the text that a Polhemus tracker sends: numbers without a header.

    Each line holds seven numbers with spaces between: station, x, y, z, azimuth,
    elevation, roll; see `read_poses` for the angles. Lines that start with `#` and
    blank lines are skipped.

    Args:
        path: The file.
        length_unit: Unit that the tracker was set to: "cm" or "inch", or another one.
        angle_unit: "deg" or "rad".
        stations: Names by station; only these are read. By default all are, with names
            like "station 1".

    Returns:
        The readings, in the order of the file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it cannot be read, a unit is unknown, a line does not hold seven
            finite numbers, a station is not there, or an angle is out of its range.

    Warns:
        TrackerWarning: If angles in degrees look like radians.
    """
    check_length_unit(length_unit)
    if angle_unit not in RADIANS:
        raise unknown_name("angle unit", angle_unit, RADIANS)
    path = Path(path)
    numbered = read_lines(path, "tracker")
    if not numbered:
        raise ValueError(f"tracker file {path} holds no readings.")
    readings = [
        (number, _seven_numbers(path, number, text)) for number, text in numbered
    ]
    present = dict.fromkeys(int(values[0]) for _, values in readings)
    wanted = stations or {station: f"station {station}" for station in present}
    for station in wanted:
        if station not in present:
            raise ValueError(
                f"{path} has no station {station}. It has "
                f"{', '.join(map(str, present))}."
            )
    chosen = [(line, v) for line, v in readings if int(v[0]) in wanted]
    lines = tuple(line for line, _ in chosen)
    values = np.array([v for _, v in chosen])
    remedy = "give angle_unit={unit!r}"
    return PoseTable(
        names=tuple(wanted[int(station)] for station in values[:, 0]),
        positions=METRES[length_unit] * values[:, 1:4],
        rotations=from_angles(
            path, lines, values[:, 4:], unit=angle_unit, remedy=remedy
        ),
        lines=lines,
        source=str(path),
    )


def _turn_columns(table: CsvTable) -> list[str]:
    """Find the columns of the three angles or of the quaternion."""
    path, header = table.path, table.header
    forms: list[list[str]] = [list(_QUATERNION)]
    forms += [[f"{angle}_{unit}" for angle in ANGLES] for unit in RADIANS]
    kinds = [columns for columns in forms if set(columns) & set(header)]
    if len(kinds) > 1:
        there = [c for columns in kinds for c in columns if c in header]
        raise ValueError(
            f"{path}: it has the rotation in more than one form ({', '.join(there)}); "
            "keep one."
        )
    if not kinds:
        bare = set(ANGLES) & set(header)
        reason = "its angles carry no unit" if bare else "it has no rotation"
        raise ValueError(
            f"{path}: {reason}; it needs the columns azimuth_deg, elevation_deg, "
            "roll_deg (or azimuth_rad, ...) or qw, qx, qy, qz. Columns there: "
            f"{', '.join(header)}."
        )
    for column in kinds[0]:
        if column not in header:
            raise missing(path, column, header)
    return kinds[0]


def _finite(table: CsvTable, row: Row, column: str) -> float:
    value = table.number(row, column)
    if not np.isfinite(value):
        raise ValueError(
            f"{table.path}, line {row.line}: {column} of sensor "
            f"{row.cells['sensor']!r} is missing or not finite. Leave the reading out."
        )
    return value


def _seven_numbers(path: Path, line: int, text: str) -> list[float]:
    cells = text.split()
    names = ("station", "x", "y", "z", *ANGLES)
    if len(cells) != len(names):
        raise ValueError(
            f"{path}, line {line}: {len(cells)} numbers where 7 are needed, with "
            f"spaces between: {', '.join(names)}."
        )
    values = []
    for name, cell in zip(names, cells, strict=True):
        try:
            values.append(float(cell))
        except ValueError as error:
            raise ValueError(
                f"{path}, line {line}: {name} is {cell!r}, not a number."
            ) from error
        if not np.isfinite(values[-1]):
            raise ValueError(f"{path}, line {line}: {name} is {cell}, not finite.")
    if values[0] != int(values[0]):
        raise ValueError(f"{path}, line {line}: station is {cells[0]}, not an integer.")
    return values
