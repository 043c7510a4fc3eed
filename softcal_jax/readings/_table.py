"""Tables as text: rows of a CSV file with a header, and the markers in them."""

import csv
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import numpy as np

from softcal_jax._files import check_file, once
from softcal_jax._module import Module
from softcal_jax._text import (
    SoftcalWarning,
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


class TrackerWarning(SoftcalWarning):
    """Something in a file of a tracker or of motion capture that may be a mistake."""


@contextmanager
def at_line(source: str | Path, number: int) -> Iterator[None]:
    """Prefix errors raised inside with a line of a file."""
    try:
        yield
    except (ValueError, csv.Error) as error:
        raise ValueError(f"{source}, line {number}: {error}") from error


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


def check_dialect(delimiter: str | None, decimal: str | None) -> None:
    stated = {"delimiter": (delimiter, _DELIMITERS), "decimal": (decimal, (".", ","))}
    for name, (value, known) in stated.items():
        if value is not None and value not in known:
            raise ValueError(f"{name} is {value!r}; expected one of {known}.")
    if delimiter == decimal == ",":
        raise ValueError("delimiter and decimal are both a comma; give another one.")


def decimal_of(rows: NumberedCells, delimiter: str) -> str:
    """Tell whether decimals have a point or a comma, from the cells of a whole file.

    In a few of its lines "1,500" may be one thousand five hundred or one and a half.
    """
    if delimiter == ",":
        return "."
    commas = any(_DECIMAL_COMMA.fullmatch(cell) for _, cells in rows for cell in cells)
    return "," if commas else "."


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


class CsvTable(NamedTuple):
    """Rows of a file below its header.

    `key` is the column that names what a row is about: "marker" or "sensor", `point` is
    the decimal point or comma, and `source` is what was read, for messages.
    """

    source: str
    key: str
    header: list[str]
    rows: NumberedCells
    point: str

    @property
    def lines(self) -> tuple[int, ...]:
        return tuple(line for line, _ in self.rows)

    @property
    def names(self) -> tuple[str, ...]:
        k = self.header.index(self.key)
        return tuple(cells[k] for _, cells in self.rows)

    def numbers(
        self, columns: Sequence[str], *, gaps: bool = True
    ) -> Float[HostArray, "n_rows n_columns"]:
        """Read the numbers in some columns, nan where a cell is blank.

        Raises:
            ValueError: If there is no such column, or a cell is not a number, or not a
                finite one where `gaps` are not allowed.
        """
        self.check_columns(columns)
        indices = [self.header.index(column) for column in columns]
        values = np.empty((len(self.rows), len(columns)))
        of_rows = zip(self.rows, self.names, strict=True)
        for i, ((line, cells), name) in enumerate(of_rows):
            with at_line(self.source, line):
                for k, index in enumerate(indices):
                    what = f"{columns[k]} of {self.key} {name!r}"
                    values[i, k] = parse_number(cells[index] or "nan", self.point, what)
                    if not (gaps or np.isfinite(values[i, k])):
                        raise ValueError(
                            f"{what} is missing or not finite. Leave the reading out."
                        )
        return values

    def check_columns(self, columns: Iterable[str]) -> None:
        """Raise ValueError for a column that is not in the header."""
        columns = list(columns)
        # A column that is asked for itself is not suggested for another.
        others = [c for c in self.header if c not in columns]
        for column in columns:
            if column not in self.header:
                raise ValueError(
                    f"{self.source}: column {column!r} is missing."
                    f"{suggestion(column, others)} Columns there, separated by commas, "
                    f"semicolons or tabs: {', '.join(self.header)}."
                )

    def selected(self, values: Mapping[str, str]) -> "CsvTable":
        """Take the rows that have the values, by column.

        Raises:
            ValueError: If there is no such column, or no such row.
        """
        self.check_columns(values)
        indices, rows = {c: self.header.index(c) for c in values}, self.rows
        for column, value in values.items():
            rows = [row for row in rows if row[1][indices[column]] == value]
        listed = ", ".join(f"{column} = {value}" for column, value in values.items())
        if not rows:
            every = lambda k: ", ".join(dict.fromkeys(row[k] for _, row in self.rows))
            hints = (f" Values of {c} there: {every(k)}." for c, k in indices.items())
            raise ValueError(f"{self.source}: no row has {listed}.{''.join(hints)}")
        return self._replace(rows=rows, source=f"{self.source} ({listed})")

    def coordinates(self, length_unit: str | None) -> tuple[list[str], float]:
        """Find the columns x, y, z or x_mm, y_mm, z_mm, and their unit in metres."""
        source, header = self.source, self.header
        if length_unit is not None:
            check_known("length unit", METRES, length_unit)
        named = lambda axes: [
            u for u in METRES if {f"{a}_{u}" for a in axes} & {*header}
        ]
        units = named("x") or named("yz")
        if len(units) > 1:
            raise ValueError(f"{source}: x has the units {', '.join(units)}; keep one.")
        unit = units[0] if units else None
        if unit is None and length_unit is None and {"x", "y", "z"} <= set(header):
            raise ValueError(
                f"{source}: its columns x, y, z carry no unit; name them like x_mm, or "
                "give length_unit."
            )
        if None not in (unit, length_unit) and unit != length_unit:
            raise ValueError(
                f"{source}: its columns are in {unit!r} (x_{unit}), but length_unit is "
                f"{length_unit!r}; leave length_unit out."
            )
        columns = [axis if unit is None else f"{axis}_{unit}" for axis in "xyz"]
        self.check_columns(columns)
        return columns, METRES[unit or str(length_unit)]


def read_table(
    path: str | os.PathLike[str],
    key: str,
    select: Mapping[str, str] | None = None,
    *,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> CsvTable:
    """Read a file and select rows, without comments (`#`) and blank lines.

    Raises:
        ValueError: If there is no column `key`, or none of `select`; or no row has its
            values, or a row has other columns than the header.
    """
    check_dialect(delimiter, decimal)
    table = _read_all(Path(path), key, delimiter, decimal)
    table.check_columns([key])
    return table.selected(select) if select else table


@once
def _read_all(
    path: Path, key: str, delimiter: str | None, decimal: str | None
) -> CsvTable:
    lines, used = read_cells(path, key, delimiter)
    if len(lines) < 2:
        raise ValueError(f"{key} file {path} holds no rows below a header.")
    (_, header), *rows = lines
    check_unique(f"{path}: its column", header)
    for number, cells in rows:
        if len(cells) != len(header):
            many = used == "," and len(cells) > len(header)
            hint = " If its numbers have decimal commas, put ; between columns." * many
            raise ValueError(
                f"{path}, line {number}: {len(cells)} cells under a header of "
                f"{len(header)} columns ({', '.join(header)}).{hint}"
            )
    return CsvTable(str(path), key, header, rows, decimal or decimal_of(lines, used))


class MarkerTable(Module):
    """Marker positions as they were read, in the frame and order of the file.

    Attributes:
        names: Names of the markers, each once.
        positions: Their positions; nan where the file says so or is blank [m].
        places: Where in the source each was, for messages, like "line 7".
        source: What was read, for messages.
        covariances: Covariance of the frames of a window of a recording about their
            mean; nan where fewer than two of them saw a marker [m2].
        window: First and last time of that window in the recording [s].
        doubts: By marker, that it is in two places within the window.
    """

    names: tuple[str, ...]
    positions: Float[HostArray, "n_markers 3"]
    places: tuple[str, ...]
    source: str
    covariances: Float[HostArray, "n_markers 3 3"] | None = None
    window: tuple[float, float] | None = None
    doubts: Mapping[str, str] = eqx.field(default_factory=dict)

    def positions_of(self, names: Sequence[str]) -> Float[HostArray, "n_wanted 3"]:
        """Return positions of some markers, in the order of their names [m].

        Raises:
            ValueError: If a marker is not there, or its position is not finite.
        """
        for name in filter(self.doubts.get, names):
            warnings.warn(f"{self.source}, {self.doubts[name]}", TrackerWarning, 2)
        remedy = "Leave a marker that was lost out of this configuration."
        return self._finite(self.positions, names, "position", remedy)

    def covariances_of(self, names: Sequence[str]) -> Float[HostArray, "n_wanted 3 3"]:
        """Return the scatter of single frames of some markers [m2].

        Raises:
            ValueError: If a marker is missing, the positions are not means over a
                window, or fewer than two frames of the window saw a marker.
        """
        if self.covariances is None:
            raise ValueError(
                f"{self.source} holds single positions, which do not scatter; take "
                "them over a window of a recording."
            )
        remedy = "Choose a longer window, of which two frames see it."
        return self._finite(self.covariances, names, "scatter", remedy)

    def _finite(self, values: HostArray, names: Sequence[str], what: str, remedy: str):
        rows = [index_of(name, self.names, self.source) for name in names]
        for name, row in zip(names, rows, strict=True):
            if not np.all(np.isfinite(values[row])):
                raise ValueError(
                    f"{self.source}, {self.places[row]}: the {what} of marker {name!r} "
                    f"is missing or not finite. {remedy}"
                )
        return values[rows]


def index_of(name: str, names: Sequence[str], source: str) -> int:
    """Return the index of a marker among the names that a source has."""
    if name not in names:
        raise ValueError(
            f"{source} has no marker {name!r}.{suggestion(name, names)} It has "
            f"{', '.join(names)}. In a project file `labels` (`renamed` of a "
            "recording) maps names of yours to those of the file."
        )
    return list(names).index(name)


def read_markers(
    path: str | os.PathLike[str],
    *,
    length_unit: str | None = None,
    select: Mapping[str, str] | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> MarkerTable:
    """Read marker positions from a CSV file with a header line.

    Columns: `marker`, and either `x`, `y`, `z` or columns that carry their unit, like
    `x_mm`, `y_mm`, `z_mm`. Any other column can be selected on. Lines that start with
    `#` and blank lines are skipped. A blank or `nan` coordinate is a marker that was
    lost: it raises only when it is asked for.

    Args:
        path: The file.
        length_unit: Unit of the coordinates: "m", "cm", "mm", "um" or "inch"; not
            needed where the columns carry it.
        select: Values by column; only the rows that have them all are taken.
        delimiter: What stands between columns: ",", ";", a tab or "|"; by default the
            most frequent one in the header.
        decimal: "." or ","; by default whichever the numbers have.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a column is missing, the unit is unknown, unstated or contradicts
            the columns, nothing is selected or a marker twice, or a coordinate is not a
            number.
    """
    table = read_table(path, "marker", select, delimiter=delimiter, decimal=decimal)
    columns, metres = table.coordinates(length_unit)
    firsts: dict[str, int] = {}
    for name, line in zip(table.names, table.lines, strict=True):
        if (first := firsts.setdefault(name, line)) != line:
            raise ValueError(
                f"{table.source}: marker {name!r} is there twice, in lines {first} and "
                f"{line}; select the rows of one recording "
                f"(columns: {', '.join(table.header)})."
            )
    return MarkerTable(
        names=table.names,
        positions=metres * table.numbers(columns),
        places=tuple(f"line {line}" for line in table.lines),
        source=table.source,
    )
