"""Rows of a CSV file with a header, and their coordinates with a unit."""

import csv
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softcal_jax._files import check_file, once
from softcal_jax._text import (
    check_characters,
    check_known,
    check_unique,
    from_cell,
    suggestion,
)
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import METRES

_DELIMITERS = (",", ";", "\t", "|")
"""Known delimiters of columns; the most frequent one in the header is taken."""

_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")

NumberedCells = Sequence[tuple[int, list[str]]]
"""The cells of each line, with its number in the file from 1."""


@contextmanager
def at_line(path: Path, number: int) -> Iterator[None]:
    """Prefix errors raised inside with a line of a file."""
    try:
        yield
    except (ValueError, csv.Error) as error:
        raise ValueError(f"{path}, line {number}: {error}") from error


class CsvTable(NamedTuple):
    """Selected rows of a file, as cells by column, and their lines from 1.

    `key` is the column that names what a row is about: "marker" or "sensor", and
    `point` is the decimal point or comma.
    """

    path: Path
    header: list[str]
    rows: list[dict[str, str]]
    lines: tuple[int, ...]
    key: str
    source: str
    point: str = "."

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(row[self.key] for row in self.rows)

    def numbers(self, columns: Sequence[str]) -> Float[HostArray, "n_rows n_columns"]:
        """Read the numbers in some columns, nan where a cell is blank."""
        values = np.full((len(self.rows), len(columns)), np.nan)
        for i, row in enumerate(self.rows):
            what = f"of {self.key} {row[self.key]!r}"
            for k, column in enumerate(columns):
                with at_line(self.path, self.lines[i]):
                    cell = row[column] or "nan"
                    values[i, k] = parse_number(cell, self.point, f"{column} {what}")
        return values

    def check_columns(self, columns: Iterable[str]) -> None:
        """Raise ValueError for a column that is not in the header."""
        columns = list(columns)
        # A column that is asked for itself is not suggested for another.
        others = [c for c in self.header if c not in columns]
        for column in columns:
            if column not in self.header:
                raise ValueError(
                    f"{self.path}: column {column!r} is missing."
                    f"{suggestion(column, others)} Columns there, separated by commas, "
                    f"semicolons or tabs: {', '.join(self.header)}."
                )


def read_table(
    path: str | os.PathLike[str],
    key: str,
    select: Mapping[str, str] | None,
    *,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> CsvTable:
    """Read a file and select rows, without comments (`#`) and blank lines."""
    path = Path(path)
    check_dialect(delimiter, decimal)
    lines, used = read_cells(path, key, delimiter)
    if len(lines) < 2:
        raise ValueError(f"{key} file {path} holds no rows below a header.")
    header = lines[0][1]
    check_unique(f"{path}: its column", header)
    for number, cells in lines[1:]:
        if len(cells) != len(header):
            many = used == "," and len(cells) > len(header)
            hint = " If its numbers have decimal commas, put ; between columns." * many
            raise ValueError(
                f"{path}, line {number}: {len(cells)} cells under a header of "
                f"{len(header)} columns ({', '.join(header)}).{hint}"
            )
    point = decimal or decimal_of((cells for _, cells in lines), used)
    table = CsvTable(path, header, [], (), key, str(path), point)
    table.check_columns([key])
    return _selected(table, lines[1:], select or {})


def check_dialect(delimiter: str | None, decimal: str | None) -> None:
    stated = {"delimiter": (delimiter, _DELIMITERS), "decimal": (decimal, (".", ","))}
    for name, (value, known) in stated.items():
        if value is not None and value not in known:
            raise ValueError(f"{name} is {value!r}; expected one of {known}.")
    if delimiter == decimal == ",":
        raise ValueError("delimiter and decimal are both a comma; give another one.")


def decimal_of(rows: Iterable[Iterable[str]], delimiter: str) -> str:
    """Tell whether decimals have a point or a comma, from the cells of a whole file.

    In a few of its lines "1,500" may be one thousand five hundred or one and a half.
    """
    if delimiter == ",":
        return "."
    commas = any(_DECIMAL_COMMA.fullmatch(cell) for cells in rows for cell in cells)
    return "," if commas else "."


@once
def read_cells(
    path: Path, key: str, delimiter: str | None, head: int = 1
) -> tuple[NumberedCells, str]:
    """Split each line into cells, by a delimiter or that of the first `head` lines."""
    texts, lines = read_lines(path, key), []
    first = "".join(text for _, text in texts[:head])
    delimiter = delimiter or max(_DELIMITERS, key=first.count)
    for number, text in texts:
        with at_line(path, number):
            cells = next(csv.reader([text], delimiter=delimiter))
        lines.append((number, [from_cell(cell.strip()) for cell in cells]))
    return lines, delimiter


def parse_number(cell: str, point: str, what: str = "a cell") -> float:
    """Read a number with a decimal point or comma; `what` names it in messages."""
    if point == "," and "." in cell:
        raise ValueError(
            f"{what} is {cell!r}, with a point in a file that has decimal commas: "
            "write all numbers with either, and none with a sign between thousands."
        )
    try:
        if "_" in cell or not cell.isascii():  # which Python's numbers may have
            raise ValueError
        return float(cell.replace(point, "."))
    except ValueError:
        hint = ": write a decimal point" if _DECIMAL_COMMA.fullmatch(cell) else ""
        raise ValueError(f"{what} is {cell!r}, not a number{hint}.") from None


def _selected(table: CsvTable, lines: NumberedCells, select: Mapping) -> CsvTable:
    """Add the rows that have the values of `select`."""
    table.check_columns(select)
    places, chosen = {c: table.header.index(c) for c in select}, lines
    for column, value in select.items():
        chosen = [line for line in chosen if line[1][places[column]] == value]
    listed = ", ".join(f"{column} = {value}" for column, value in select.items())
    if not chosen:
        values = {c: dict.fromkeys(row[places[c]] for _, row in lines) for c in select}
        hints = (f" Values of {c} there: {', '.join(values[c])}." for c in select)
        raise ValueError(f"{table.path}: no row has {listed}.{''.join(hints)}")
    return table._replace(
        rows=[dict(zip(table.header, cells, strict=True)) for _, cells in chosen],
        lines=tuple(number for number, _ in chosen),
        source=f"{table.path} ({listed})" if select else table.source,
    )


def read_lines(path: Path, key: str) -> list[tuple[int, str]]:
    """Read lines that are neither blank nor comments (`#`), with numbers from 1."""
    check_file(path, f"{key} file")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{key} file {path} cannot be read: {error}. Save it as UTF-8 (in a "
            'spreadsheet, "CSV UTF-8").'
        ) from error
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    for number, line in lines:
        if not line.isprintable():  # quick, for long tables
            with at_line(path, number):
                check_characters(line)
    return lines


def coordinates(table: CsvTable, length_unit: str | None) -> tuple[list[str], float]:
    """Find the columns x, y, z or x_mm, y_mm, z_mm, and their unit in metres."""
    path, header = table.path, table.header
    if length_unit is not None:
        check_known("length unit", METRES, length_unit)
    named = lambda axes: [u for u in METRES if {f"{a}_{u}" for a in axes} & {*header}]
    units = named("x") or named("yz")
    if len(units) > 1:
        raise ValueError(f"{path}: x has the units {', '.join(units)}; keep one.")
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
