"""Rows of a CSV file with a header, and their coordinates with a unit."""

import csv
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from softcal_jax._names import METRES, suggestion


class Row(NamedTuple):
    """A line of the file, from 1, and its cells by column."""

    line: int
    cells: dict[str, str]


class CsvTable(NamedTuple):
    """The selected rows of a file.

    `key` is the column that names what a row is about: "marker" or "sensor".
    """

    path: Path
    header: list[str]
    rows: list[Row]
    key: str
    source: str

    def number(self, row: Row, column: str) -> float:
        """Read the number in a cell, nan if it is blank.

        Raises:
            ValueError: If it is something else.
        """
        cell = row.cells[column]
        if not cell:
            return float("nan")
        try:
            return float(cell)
        except ValueError as error:
            raise ValueError(
                f"{self.path}, line {row.line}: {column} of {self.key} "
                f"{row.cells[self.key]!r} is {cell!r}, not a number."
            ) from error


def read_table(
    path: str | os.PathLike[str], key: str, select: Mapping[str, str] | None
) -> CsvTable:
    """Read a file and select rows, without comments (`#`) and blank lines.

    Args:
        path: The file.
        key: Column that names what a row is about.
        select: Column and value pairs; only the rows that have them all are taken.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it cannot be read, its rows do not match its header, the column
            `key` is missing, or nothing is selected.
    """
    path = Path(path)
    header, rows = _read_rows(path, key)
    chosen = _selected(path, header, rows, dict(select or {}))
    source = str(path)
    if select:
        source += f" ({_listed(select.items())})"
    return CsvTable(path=path, header=header, rows=chosen, key=key, source=source)


def read_lines(path: Path, key: str) -> list[tuple[int, str]]:
    """Read lines that are neither blank nor comments (`#`), with numbers from 1.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not a text file.
    """
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


def _read_rows(path: Path, key: str) -> tuple[list[str], list[Row]]:
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
        rows.append(Row(number, dict(zip(header, cells, strict=True))))
    if key not in header:
        raise missing(path, key, header)
    return header, rows


def _selected(
    path: Path, header: list[str], rows: list[Row], select: dict[str, str]
) -> list[Row]:
    for column, value in select.items():
        if column not in header:
            raise missing(path, column, header)
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


def check_length_unit(unit: str) -> None:
    """Raise ValueError unless the unit of length is known."""
    if unit not in METRES:
        raise ValueError(
            f"unknown length unit {unit!r}.{suggestion(unit, METRES)} "
            f"Known: {', '.join(METRES)}."
        )


def coordinates(table: CsvTable, length_unit: str | None) -> tuple[list[str], float]:
    """Find the columns x, y, z or x_mm, y_mm, z_mm, and their unit in metres.

    Raises:
        ValueError: If a column is missing, or the unit is unknown, unstated or
            contradicts the columns.
    """
    path, header = table.path, table.header
    if length_unit is not None:
        check_length_unit(length_unit)
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
    for column in columns:
        if column not in header:
            raise missing(path, column, header)
    return columns, METRES[unit or str(length_unit)]


def _unit_of_columns(path: Path, header: list[str]) -> str | None:
    """Return the unit that the column of x carries in its name, if any."""
    units = [unit for unit in METRES if f"x_{unit}" in header]
    if len(units) > 1:
        raise ValueError(
            f"{path}: it has the coordinates in more than one unit "
            f"({', '.join(f'x_{unit}' for unit in units)}); keep one."
        )
    return units[0] if units else None


def missing(path: Path, column: str, header: list[str]) -> ValueError:
    """Make the error for a column that is not in the header."""
    hint = suggestion(column, header)
    if len(header) == 1:
        hint += " Separate the columns by commas."
    return ValueError(
        f"{path}: column {column!r} is missing.{hint} Columns there: "
        f"{', '.join(header)}."
    )


def _listed(pairs: Iterable[tuple[str, str]]) -> str:
    return ", ".join(f"{column} = {value}" for column, value in pairs)
