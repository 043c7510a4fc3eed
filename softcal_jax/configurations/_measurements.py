"""Measured marker positions from a CSV file."""

import csv
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import numpy as np

from softcal_jax._names import METRES, suggestion
from softcal_jax._typing import Float, HostArray


class MarkerTable(eqx.Module):
    """Marker positions as they were read, in the frame and order of the file.

    Attributes:
        names: Names of the markers, each once.
        positions: Their positions; nan where the file says so or is blank [m].
        lines: Line of the file that each stands on, from 1.
        source: What was read, for messages.
    """

    names: tuple[str, ...]
    positions: Float[HostArray, "n_markers 3"]
    lines: tuple[int, ...]
    source: str

    def positions_of(self, names: Sequence[str]) -> Float[HostArray, "n_wanted 3"]:
        """Positions of some markers, in the order of their names [m].

        Args:
            names: Markers, each in the table.

        Raises:
            ValueError: If a marker is not there, or its position is not finite.
        """
        rows = []
        for name in names:
            if name not in self.names:
                raise ValueError(
                    f"{self.source} has no marker {name!r}."
                    f"{suggestion(name, self.names)} It has {', '.join(self.names)}."
                )
            row = self.names.index(name)
            if not np.all(np.isfinite(self.positions[row])):
                raise ValueError(
                    f"{self.source}, line {self.lines[row]}: the position of marker "
                    f"{name!r} is missing or not finite. Leave a marker that was lost "
                    "out of this configuration."
                )
            rows.append(row)
        return self.positions[rows]


class _Row(NamedTuple):
    line: int
    cells: dict[str, str]


def read_markers(
    path: str | os.PathLike[str],
    *,
    length_unit: str | None = None,
    select: Mapping[str, str] | None = None,
) -> MarkerTable:
    """Reads marker positions from a CSV file with a header line.

    Columns: `marker`, and either `x`, `y`, `z` or columns that carry their unit, like
    `x_mm`, `y_mm`, `z_mm`. Any other column can be selected on. Lines that start with
    `#` and blank lines are skipped. A blank or `nan` coordinate is a marker that was
    lost: it is kept, and refused only where it is asked for.

    Args:
        path: The file.
        length_unit: Unit of the coordinates: "m", "cm", "mm", "um" or "inch"; not
            needed where the columns carry it.
        select: Column and value pairs; only the rows that have them all are taken.

    Returns:
        The selected markers.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it cannot be read, a column is missing, the unit is unknown,
            unstated or contradicts the columns, nothing is selected, a marker is
            selected twice, or a coordinate is not a number.

    Example:
        The rows of one recording::

            read_markers("markers.csv", select={"run": "gravity", "phase": "held"})
    """
    path = Path(path)
    header, rows = _read_rows(path)
    coordinates, metres = _coordinates(path, header, length_unit)
    chosen = _selected(path, header, rows, dict(select or {}))
    names, positions = [], []
    for row in chosen:
        name = row.cells["marker"]
        if name in names:
            first = chosen[names.index(name)].line
            raise ValueError(
                f"{path}: marker {name!r} is there twice, in lines {first} and "
                f"{row.line}; select the rows of one recording "
                f"(columns: {', '.join(header)})."
            )
        names.append(name)
        positions.append([_number(path, row, column) for column in coordinates])
    what = str(path)
    if select:
        what += f" ({_listed(select.items())})"
    return MarkerTable(
        tuple(names),
        metres * np.array(positions).reshape(-1, 3),
        tuple(row.line for row in chosen),
        what,
    )


def _read_rows(path: Path) -> tuple[list[str], list[_Row]]:
    if not path.exists():
        raise FileNotFoundError(f"marker file {path} does not exist.")
    if not path.is_file():
        raise ValueError(f"marker file {path} is a directory.")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (UnicodeDecodeError, OSError) as error:
        raise ValueError(f"marker file {path} cannot be read: {error}.") from error
    # Line by line, so that a message can name the line: a cell never spans two.
    lines = [
        (number, [cell.strip() for cell in next(csv.reader([line]))])
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if len(lines) < 2:
        raise ValueError(f"marker file {path} holds no rows below a header.")
    header = lines[0][1]
    for column in header:
        if header.count(column) > 1:
            raise ValueError(f"{path}: its header has the column {column!r} twice.")
    rows = []
    for number, cells in lines[1:]:
        if len(cells) != len(header):
            raise ValueError(
                f"{path}, line {number}: {len(cells)} cells under a header of "
                f"{len(header)} columns ({', '.join(header)})."
            )
        rows.append(_Row(number, dict(zip(header, cells, strict=True))))
    return header, rows


def _coordinates(
    path: Path, header: list[str], length_unit: str | None
) -> tuple[list[str], float]:
    """Names of the three coordinate columns, and their unit in metres."""
    if length_unit is not None and length_unit not in METRES:
        raise ValueError(
            f"unknown length unit {length_unit!r}.{suggestion(length_unit, METRES)} "
            f"Known: {', '.join(METRES)}."
        )
    unit = _unit_of_columns(path, header)
    if unit is None and length_unit is None and {"x", "y", "z"} <= set(header):
        raise ValueError(
            f"{path}: its columns x, y, z carry no unit; name them like x_mm, or give "
            "length_unit."
        )
    if None not in (unit, length_unit) and unit != length_unit:
        raise ValueError(
            f"{path}: its columns are in {unit!r} (x_{unit}), but length_unit is "
            f"{length_unit!r}; leave length_unit out."
        )
    columns = [axis if unit is None else f"{axis}_{unit}" for axis in "xyz"]
    for column in ("marker", *columns):
        if column not in header:
            raise _missing(path, column, header)
    return columns, METRES[unit or str(length_unit)]


def _unit_of_columns(path: Path, header: list[str]) -> str | None:
    """The unit that the column of x carries in its name, if any."""
    units = [unit for unit in METRES if f"x_{unit}" in header]
    if len(units) > 1:
        raise ValueError(
            f"{path}: it has the coordinates in more than one unit "
            f"({', '.join(f'x_{unit}' for unit in units)}); keep one."
        )
    return units[0] if units else None


def _selected(
    path: Path, header: list[str], rows: list[_Row], select: dict[str, str]
) -> list[_Row]:
    for column, value in select.items():
        if column not in header:
            raise _missing(path, column, header)
        present = list(dict.fromkeys(row.cells[column] for row in rows))
        if value not in present:
            raise ValueError(
                f"{path}: no row has {column} = {value!r}.{suggestion(value, present)} "
                f"Values there: {', '.join(present)}."
            )
    chosen = [
        row
        for row in rows
        if all(row.cells[column] == value for column, value in select.items())
    ]
    if not chosen:
        raise ValueError(
            f"{path}: no row has {_listed(select.items())} together, although each "
            "value is there."
        )
    return chosen


def _number(path: Path, row: _Row, column: str) -> float:
    cell = row.cells[column]
    if not cell:
        return float("nan")
    try:
        return float(cell)
    except ValueError as error:
        raise ValueError(
            f"{path}, line {row.line}: {column} of marker {row.cells['marker']!r} is "
            f"{cell!r}, not a number."
        ) from error


def _missing(path: Path, column: str, header: list[str]) -> ValueError:
    hint = suggestion(column, header)
    if len(header) == 1:
        hint += " Separate the columns by commas."
    return ValueError(
        f"{path}: column {column!r} is missing.{hint} Columns there: "
        f"{', '.join(header)}."
    )


def _listed(pairs: Iterable[tuple[str, str]]) -> str:
    return ", ".join(f"{column} = {value}" for column, value in pairs)
