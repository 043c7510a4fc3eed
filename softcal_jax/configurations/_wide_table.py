"""Wide tables of motion capture: a row for each frame, three columns for each marker.

Motive (OptiTrack, format 1.2x), Vicon Nexus (section "Trajectories") and Qualisys Track
Manager export them. They differ only in the lines above the numbers, which say what the
columns are. Sources: docs.optitrack.com, "Data Export: CSV" (Motive 3);
docs.qualisys.com, "Motion data (.tsv)" (QTM 2024); for Nexus files that it wrote.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softcal_jax._names import METRES
from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations._csv_table import (
    check_dialect,
    check_length_unit,
    decimal_of,
    delimiter_of,
    parse_number,
    read_cells,
    read_lines,
)
from softcal_jax.configurations._recording import Recording

_KIND = "recording"
_GAPS = {"", "nan", "null"}
"""What stands for a coordinate of a marker that was not seen, in small letters."""

_HEADER_LINES = 12
"""Lines from which the delimiter is told."""

Cells = Sequence[str]
Rows = Sequence[tuple[int, Cells]]
"""Rows of cells, with their lines in the file from 1."""

Timer = Callable[[int, Cells, Callable[[str], float]], float]


class _Layout(NamedTuple):
    """What the lines above the numbers say.

    Attributes:
        columns: The first of the three columns of each marker.
        rows: The rows of numbers.
        time: Function from the index of a row, its cells and their reader to its time
            [s].
        unit: Unit of length; None if the file states none.
        events: Names and times of events.
        zero_is_gap: Whether a marker at exactly (0, 0, 0) was not seen.
    """

    columns: dict[str, int]
    rows: Rows
    time: "Timer"
    unit: str | None
    events: tuple[tuple[str, float], ...] = ()
    zero_is_gap: bool = False


def read_wide_table(
    path: str | os.PathLike[str],
    *,
    length_unit: str | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> Recording:
    """Read a recording that Motive, Nexus or QTM exported as text.

    Labels and unit are those of the header, and blank cells are occlusions; in a file
    of QTM, which may write zeros instead, so are markers at exactly (0, 0, 0). Of
    Motive's columns those of type "Marker" are read, which were seen, and not the
    solved ones of rigid bodies.

    Args:
        path: The file.
        length_unit: Unit of length, for a file that states none, like those of QTM
            (which are in mm).
        delimiter: As for `read_markers`.
        decimal: As for `read_markers`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it cannot be read, is none of these tables, holds no frames or
            no markers, or one label twice, does not state a known unit of length, or a
            cell is not a number.
    """
    path = Path(path)
    check_dialect(delimiter, decimal)
    lines = read_lines(path, _KIND)
    delimiter = delimiter or delimiter_of(text for _, text in lines[:_HEADER_LINES])
    rows = [row for row in read_cells(path, lines, delimiter) if any(row[1])]
    kinds = [read for read, is_kind in _KINDS if is_kind(rows)]
    if rows and "marker" in rows[0][1]:
        raise ValueError(
            f"{path} is a table of rows, with a column marker: take its rows by values "
            "of columns, not by a window of time."
        )
    if not kinds:
        raise ValueError(
            f"{path} is no table of motion capture that is known: expected a header "
            'that begins with "Format Version" (Motive), with "NO_OF_FRAMES" '
            '(Qualisys), or a section "Trajectories" (Vicon).'
        )
    layout = kinds[0](path, rows)
    if not layout.rows or not layout.columns:
        what = "frames" if layout.columns else "labelled markers"
        raise ValueError(f"recording {path} holds no {what}.")
    metres = _metres(path, layout.unit, length_unit)
    point = decimal or decimal_of((cells for _, cells in layout.rows), delimiter)
    times, positions = _numbers(path, layout, point)
    return Recording(
        names=tuple(layout.columns),
        times=times - times[0],
        positions=metres * positions,
        source=str(path),
        events=tuple((name, time - times[0]) for name, time in layout.events),
    )


def is_wide_table(path: Path) -> bool:
    """Tell whether a file is one of these tables; it may be anything."""
    lines = read_lines(path, _KIND)
    delimiter = delimiter_of(text for _, text in lines[:_HEADER_LINES])
    rows = [(n, [c.strip() for c in text.split(delimiter)]) for n, text in lines]
    return any(is_kind(rows) for _, is_kind in _KINDS)


def _metres(path: Path, stated: str | None, given: str | None) -> float:
    if given is not None:
        check_length_unit(given)
    if stated is None and given is None:
        raise ValueError(
            f"{path} states no unit of length; give length_unit (Qualisys writes mm)."
        )
    if None not in (stated, given) and stated != given:
        raise ValueError(
            f"{path} states the unit of length {stated!r}, but length_unit is "
            f"{given!r}; leave length_unit out."
        )
    return METRES[stated or str(given)]


def _numbers(
    path: Path, layout: _Layout, point: str
) -> tuple[Float[HostArray, " n_frames"], Float[HostArray, "n_frames n_markers 3"]]:
    """Read times [s] and positions, nan where a marker was not seen."""
    wanted = [first + k for first in layout.columns.values() for k in range(3)]
    times = np.empty(len(layout.rows))
    values = np.full((len(layout.rows), len(wanted)), np.nan)
    number = lambda cell: parse_number(cell, point)
    for i, (line, cells) in enumerate(layout.rows):
        try:
            times[i] = layout.time(i, cells, number)
            # Spreadsheets leave out blank cells at the end of a row.
            values[i] = [
                np.nan
                if k >= len(cells) or cells[k].lower() in _GAPS
                else number(cells[k])
                for k in wanted
            ]
        except ValueError as error:
            raise ValueError(
                f"{path}, line {line}: a cell is {error}. A marker that was not seen "
                "has blank cells, nan or NULL."
            ) from error
        if i and not times[i] > times[i - 1]:
            raise ValueError(
                f"{path}, line {line}: its time, {times[i]:g} s, is not after that of "
                f"the frame before, {times[i - 1]:g} s."
            )
    positions = values.reshape(len(times), -1, 3)
    if layout.zero_is_gap:
        positions[np.all(positions == 0.0, axis=2)] = np.nan
    return times, positions


def _labelled(path: Path, labels: Sequence[tuple[str, int]]) -> dict[str, int]:
    names = [name for name, _ in labels]
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise ValueError(f"recording {path} has the label {repeated[0]!r} twice.")
    return dict(labels)


def _row_of(rows: Rows, first: str) -> int | None:
    """Find the first row that begins with a cell."""
    return next((i for i, (_, cells) in enumerate(rows) if cells[0] == first), None)


def _positive(path: Path, what: str, text: str) -> float:
    try:
        value = parse_number(text, ".")
    except ValueError:
        value = np.nan
    if not (np.isfinite(value) and value > 0.0):
        raise ValueError(f"{path}: its {what} is {text!r}; expected a positive number.")
    return value


_MOTIVE_UNITS = {
    "Meters": "m",
    "Centimeters": "cm",
    "Millimeters": "mm",
    "Inches": "inch",
}


def _motive(path: Path, rows: Rows) -> _Layout:
    """Read the header of Motive: types, names, IDs, what each column is, and axes."""
    about = rows[0][1]
    take = dict(zip(about[::2], about[1::2], strict=False))
    unit = take.get("Length Units", "")
    if unit not in _MOTIVE_UNITS:
        raise ValueError(
            f"{path} has the Length Units {unit!r}; expected one of "
            f"{', '.join(_MOTIVE_UNITS)}."
        )
    header = _row_of(rows, "Frame")
    # Between are types, names, in most versions IDs and parents, and what it is.
    if header is None or header < 4:
        raise ValueError(
            f"{path}: expected the rows Type, Name, Position and Frame below the first "
            "line; export it with its header."
        )
    (_, types), (_, names), *_, (_, whats) = rows[1:header]
    axes = rows[header][1]
    at = lambda cells, k: cells[k] if k < len(cells) else ""
    measured = [
        k
        for k in range(len(axes))
        if (at(types, k), at(whats, k)) == ("Marker", "Position")
    ]
    if not measured:
        kinds = ", ".join(sorted({t for t in types if t} - {"Type"})) or "nothing"
        raise ValueError(
            f"{path} holds no measured markers, only {kinds}: switch Markers on when "
            "you export it."
        )
    labels = [(names[k], k) for k in measured if axes[k : k + 3] == ["X", "Y", "Z"]]
    time = next((k for k, cell in enumerate(axes) if cell.startswith("Time (")), None)
    if time is None:
        raise ValueError(f"{path}, line {rows[header][0]}: there is no column of time.")
    return _Layout(
        columns=_labelled(path, labels),
        rows=rows[header + 1 :],
        time=lambda i, cells, number: number(cells[time]),
        unit=_MOTIVE_UNITS[unit],
    )


def _vicon(path: Path, rows: Rows) -> _Layout:
    """Read the header of the section Trajectories: rate, labels, axes, units."""
    start = _row_of(rows, "Trajectories")
    assert start is not None
    header = rows[start + 1 : start + 5]
    if len(header) < 4 or header[2][1][0] != "Frame":
        raise ValueError(
            f"{path}, line {rows[start][0]}: below Trajectories expected the rate, and "
            "rows of labels, of Frame, X, Y, Z, and of units."
        )
    (_, rate_row), (_, names), (_, axes), (line, units) = header
    rate = _positive(path, "rate of frames", rate_row[0])
    labels = [
        (name, k)
        for k, name in enumerate(names)
        if name and axes[k : k + 3] == ["X", "Y", "Z"]
    ]
    of_markers = [k + i for _, k in labels for i in range(3)]
    found = {units[k] if k < len(units) else "" for k in of_markers}
    if len(found) != 1 or not found <= {*METRES}:
        stated = ", ".join(sorted(map(repr, found))) or "none"
        raise ValueError(
            f"{path}, line {line}: its units of length are {stated}; expected one of "
            f"{', '.join(METRES)} for all markers."
        )
    frames = rows[start + 5 :]
    # Another section may follow.
    end = next((i for i, (_, c) in enumerate(frames) if not c[0].isdecimal()), None)
    return _Layout(
        columns=_labelled(path, labels),
        rows=frames[:end],
        time=lambda i, cells, number: number(cells[0]) / rate,
        unit=found.pop(),
    )


def _qualisys(path: Path, rows: Rows) -> _Layout:
    """Read the header of QTM: names and values, and perhaps names of columns."""
    last = _row_of(rows, "MARKER_NAMES")
    about = {cells[0]: cells[1:] for _, cells in rows[: (last or 0) + 1]}
    included = (about.get("DATA_INCLUDED") or [""])[0]
    if last is None or included != "3D":
        raise ValueError(
            f"{path} includes {included or 'unknown'} data, not 3D positions with "
            "MARKER_NAMES: export 3D data with the TSV header."
        )
    labels = [label for label in about["MARKER_NAMES"] if label]
    rest = rows[last + 1 :]
    if rest and rest[0][1][0] == "TRAJECTORY_TYPES":
        rest = rest[1:]
    titles = rest[0][1] if rest else []
    if f"{labels[0] if labels else ''} X" in titles:
        first, rest = titles.index(f"{labels[0]} X"), rest[1:]
    else:  # a tab may end the row
        first = (len(titles) - 3 * len(labels)) // 2 * 2
    if first not in (0, 2):
        line = rest[0][0] if rest else rows[last][0]
        raise ValueError(
            f"{path}, line {line}: expected three columns for each of the "
            f"{len(labels)} markers, and before these perhaps Frame and Time; got "
            f"{len(titles)} columns."
        )
    return _Layout(
        columns=_labelled(path, [(x, first + 3 * i) for i, x in enumerate(labels)]),
        rows=rest,
        time=_qualisys_time(path, about, timed=first == 2),
        unit=None,
        events=tuple(
            (cells[1], parse_number(cells[3].replace(",", "."), "."))
            for _, cells in rows[:last]
            if cells[0] == "EVENT" and len(cells) > 3
        ),
        zero_is_gap=True,
    )


def _qualisys_time(path: Path, about: Mapping[str, Cells], *, timed: bool) -> Timer:
    if timed:
        return lambda i, cells, number: number(cells[1])
    frequency = (about.get("FREQUENCY") or [""])[0].replace(",", ".")
    rate = _positive(path, "FREQUENCY", frequency)
    return lambda i, cells, number: i / rate


_KINDS: tuple[tuple[Callable[[Path, Rows], _Layout], Callable[[Rows], bool]], ...] = (
    (_motive, lambda rows: bool(rows) and rows[0][1][0] == "Format Version"),
    (_qualisys, lambda rows: _row_of(rows[:3], "NO_OF_FRAMES") is not None),
    (_vicon, lambda rows: _row_of(rows, "Trajectories") is not None),
)
"""Each kind of file: what reads its header, and what tells it."""
