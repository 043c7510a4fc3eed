"""Rows of a CSV file with a header, their coordinates with a unit, and markers."""

import csv
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import numpy as np

from softcal_jax._names import METRES, suggestion
from softcal_jax._typing import Float, HostArray


class CsvTable(NamedTuple):
    """The selected rows of a file, as cells by column, and their lines from 1.

    `key` is the column that names what a row is about: "marker" or "sensor".
    """

    path: Path
    header: list[str]
    rows: list[dict[str, str]]
    lines: tuple[int, ...]
    key: str
    source: str

    @property
    def names(self) -> tuple[str, ...]:
        """What each row is about."""
        return tuple(row[self.key] for row in self.rows)

    def numbers(self, columns: Sequence[str]) -> Float[HostArray, "n_rows n_columns"]:
        """Read the numbers in some columns, nan where a cell is blank."""
        values = np.full((len(self.rows), len(columns)), np.nan)
        for i, row in enumerate(self.rows):
            for k, column in enumerate(columns):
                try:
                    values[i, k] = float(row[column] or "nan")
                except ValueError as error:
                    raise ValueError(
                        f"{self.path}, line {self.lines[i]}: {column} of {self.key} "
                        f"{row[self.key]!r} is {row[column]!r}, not a number."
                    ) from error
        return values

    def check_columns(self, columns: Iterable[str]) -> None:
        """Raise ValueError for a column that is not in the header."""
        for column in columns:
            if column in self.header:
                continue
            hint = suggestion(column, self.header)
            if len(self.header) == 1:
                hint += " Separate the columns by commas."
            raise ValueError(
                f"{self.path}: column {column!r} is missing.{hint} Columns there: "
                f"{', '.join(self.header)}."
            )


def read_table(
    path: str | os.PathLike[str], key: str, select: Mapping[str, str] | None
) -> CsvTable:
    """Read a file and select rows, without comments (`#`) and blank lines."""
    path = Path(path)
    # Parsed line by line, so that messages can name the line: no cell spans two.
    lines = [
        (number, [cell.strip() for cell in next(csv.reader([line]))])
        for number, line in read_lines(path, key)
    ]
    if len(lines) < 2:
        raise ValueError(f"{key} file {path} holds no rows below a header.")
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
        rows.append(dict(zip(header, cells, strict=True)))
    numbers = tuple(number for number, _ in lines[1:])
    table = CsvTable(path, header, rows, numbers, key, str(path))
    table.check_columns([key])
    return _selected(table, select) if select else table


def _selected(table: CsvTable, select: Mapping[str, str]) -> CsvTable:
    for column, value in select.items():
        table.check_columns([column])
        present = list(dict.fromkeys(row[column] for row in table.rows))
        if value not in present:
            raise ValueError(
                f"{table.path}: no row has {column} = {value!r}."
                f"{suggestion(value, present)} Values there: {', '.join(present)}."
            )
    listed = ", ".join(f"{column} = {value}" for column, value in select.items())
    # The items of a dictionary are a set: those of `select` are among those of a row.
    chosen = [i for i, row in enumerate(table.rows) if select.items() <= row.items()]
    if not chosen:
        raise ValueError(
            f"{table.path}: no row has {listed} together, although each value is there."
        )
    return table._replace(
        rows=[table.rows[i] for i in chosen],
        lines=tuple(table.lines[i] for i in chosen),
        source=f"{table.path} ({listed})",
    )


def read_lines(path: Path, key: str) -> list[tuple[int, str]]:
    """Read lines that are neither blank nor comments (`#`), with numbers from 1."""
    if not path.exists():
        raise FileNotFoundError(f"{key} file {path} does not exist.")
    if not path.is_file():
        raise ValueError(f"{key} file {path} is a directory.")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (UnicodeDecodeError, OSError) as error:
        raise ValueError(f"{key} file {path} cannot be read: {error}.") from error
    return [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]


def check_length_unit(unit: str) -> None:
    """Raise ValueError unless the unit of length is known."""
    if unit not in METRES:
        raise ValueError(
            f"unknown length unit {unit!r}.{suggestion(unit, METRES)} "
            f"Known: {', '.join(METRES)}."
        )


def coordinates(table: CsvTable, length_unit: str | None) -> tuple[list[str], float]:
    """Find the columns x, y, z or x_mm, y_mm, z_mm, and their unit in metres."""
    path, header = table.path, table.header
    if length_unit is not None:
        check_length_unit(length_unit)
    units = [unit for unit in METRES if f"x_{unit}" in header]
    if len(units) > 1:
        raise ValueError(
            f"{path}: it has the coordinates in more than one unit "
            f"({', '.join(f'x_{unit}' for unit in units)}); keep one."
        )
    unit = units[0] if units else None
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
    table.check_columns(columns)
    return columns, METRES[unit or str(length_unit)]


class MarkerTable(eqx.Module):
    """Marker positions as they were read, in the frame and order of the file.

    Attributes:
        names: Names of the markers, each once.
        positions: Their positions; nan where the file says so or is blank [m].
        places: Where in the source each was, for messages, like "line 7".
        source: What was read, for messages.
    """

    names: tuple[str, ...]
    positions: Float[HostArray, "n_markers 3"]
    places: tuple[str, ...]
    source: str

    def positions_of(self, names: Sequence[str]) -> Float[HostArray, "n_wanted 3"]:
        """Return positions of some markers, in the order of their names [m].

        Raises:
            ValueError: If a marker is not there, or its position is not finite.
        """
        for name in names:
            if name not in self.names:
                raise ValueError(
                    f"{self.source} has no marker {name!r}."
                    f"{suggestion(name, self.names)} It has {', '.join(self.names)}."
                )
            row = self.names.index(name)
            if not np.all(np.isfinite(self.positions[row])):
                raise ValueError(
                    f"{self.source}, {self.places[row]}: the position of marker "
                    f"{name!r} is missing or not finite. Leave a marker that was lost "
                    "out of this configuration."
                )
        return self.positions[[self.names.index(name) for name in names]]


def read_markers(
    path: str | os.PathLike[str],
    *,
    length_unit: str | None = None,
    select: Mapping[str, str] | None = None,
) -> MarkerTable:
    """Read marker positions from a CSV file with a header line.

    Columns: `marker`, and either `x`, `y`, `z` or columns that carry their unit, like
    `x_mm`, `y_mm`, `z_mm`. Any other column can be selected on. Lines that start with
    `#` and blank lines are skipped. A blank or `nan` coordinate is a marker that was
    lost: it is kept, and raises only when it is asked for.

    Args:
        path: The file.
        length_unit: Unit of the coordinates: "m", "cm", "mm", "um" or "inch"; not
            needed where the columns carry it.
        select: Column and value pairs; only the rows that have them all are taken.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it cannot be read, a column is missing, the unit is unknown,
            unstated or contradicts the columns, nothing is selected, a marker is
            selected twice, or a coordinate is not a number.

    Example:
        The rows of one recording::

            read_markers("markers.csv", select={"run": "gravity", "phase": "held"})
    """
    table = read_table(path, "marker", select)
    columns, metres = coordinates(table, length_unit)
    for name, line in zip(table.names, table.lines, strict=True):
        first = table.lines[table.names.index(name)]
        if first != line:
            raise ValueError(
                f"{table.path}: marker {name!r} is there twice, in lines {first} and "
                f"{line}; select the rows of one recording "
                f"(columns: {', '.join(table.header)})."
            )
    positions = metres * table.numbers(columns)
    places = tuple(f"line {line}" for line in table.lines)
    return MarkerTable(table.names, positions, places, table.source)
