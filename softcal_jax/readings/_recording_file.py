"""Files of recordings: C3D, and the wide tables that motion capture exports.

A wide table has a row for each frame and three columns for each marker. Motive
(OptiTrack, format 1.2x), Vicon Nexus (section "Trajectories") and Qualisys Track
Manager export them. They differ only in the lines above the numbers, which say what the
columns are. Sources: docs.optitrack.com, "Data Export: CSV" (Motive 3);
docs.qualisys.com, "Motion data (.tsv)" (QTM 2024); for Nexus files that it wrote.
Scripts often write the numbers alone; their markers are named by place, "1", "2", ...
"""

import importlib.util
import itertools
import math
import os
import re
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from softcal_jax._apart import run_apart
from softcal_jax._files import check_file, once
from softcal_jax._text import check_known, escaped
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import METRES
from softcal_jax.readings._recording import Recording
from softcal_jax.readings._table import (
    NumberedCells,
    TrackerWarning,
    at_line,
    check_dialect,
    decimal_of,
    parse_number,
    read_cells,
)

_C3D = ".c3d"


def is_recording(path: Path) -> bool:
    """Whether a file is a recording over time; it may be any text."""
    if path.suffix.lower() == _C3D:
        return True
    return _reader_of(_rows_of(path, None)[0]) is not None


def read_recording(
    path: str | os.PathLike[str],
    *,
    length_unit: str | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> Recording:
    """Read a recording: C3D, text of Motive, Nexus or QTM, or numbers.

    Of C3D, the format of www.c3d.org, labels and units are those of the file, and a
    negative residual says that a marker was not seen. It needs ezc3d.

    A table of numbers alone has the time in seconds, perhaps after the number of the
    frame, then x, y, z of each marker; markers are named by place, "1", "2" and so on.
    Of other text, labels and unit are those of the header. Blank cells are occlusions,
    and so are markers at exactly (0, 0, 0), which QTM and scripts write instead. Of
    Motive's columns only the measured ones, of type "Marker", are read, and not those
    that it computes from rigid bodies.

    Options are for text only. The `length_unit` is for a file that states none, like
    those of QTM (which are in mm) or of numbers alone; `delimiter` and `decimal` are as
    for `read_markers`.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If it is a .c3d file, and ezc3d is not installed.
        ValueError: If an option is given for a .c3d file; or if it cannot be read as
            one of these, holds no frames or no markers, or one label twice, states no
            positive rate or no known unit of length, or a cell is not a number.

    Warns:
        TrackerWarning: If markers without a label are left out.
    """
    path = Path(path)
    if path.suffix.lower() != _C3D:
        return _read_text(path, length_unit, delimiter, decimal)
    options = {"length_unit": length_unit, "delimiter": delimiter, "decimal": decimal}
    for key, value in options.items():
        if value is not None:
            raise ValueError(f"{key} is for tables; leave it out for {path}.")
    return _read_c3d(path)


def _recording(
    path: Path,
    labels: Sequence[str],
    times: Float[HostArray, " n_frames"],
    positions: Float[HostArray, "n_frames n_markers 3"],
    events: tuple[tuple[str, float], ...],
) -> Recording:
    """Leave out markers without a label; one at exactly (0, 0, 0) was not seen."""
    positions[~positions.any(axis=2)] = np.nan
    named = [k for k, label in enumerate(labels) if label.strip()]
    if n := len(labels) - len(named):
        text = f"{path}: {n} of {len(labels)} markers have no label and are left out."
        warnings.warn(text, TrackerWarning, stacklevel=4)
    names = tuple(labels[k] for k in named)
    return Recording(names, times, positions[:, named], str(path), events)


def _read_c3d(path: Path) -> Recording:
    if importlib.util.find_spec("ezc3d") is None:
        raise ImportError(
            "reading .c3d files needs ezc3d: pip install 'softcal-jax[mocap]'."
        )
    check_file(path, "recording")
    try:
        program = Path(__file__).with_name("_c3d_program.py")
        data, _ = run_apart(program, str(path.absolute()))
        point, event = data["POINT"], data["EVENT"]
        rate = float(point["RATE"][0])
        # Each time is a number of minutes and one of seconds.
        parts = [np.reshape(part, (2, -1)) for part in _parts(event, "TIMES")]
        times = np.array([60.0, 1.0]) @ np.concatenate([np.empty((2, 0)), *parts], 1)
        # They count from the first frame of the trial, of which this may be a part.
        times -= data["first_frame"] / rate
    except (LookupError, MemoryError, OSError, RuntimeError, ValueError) as error:
        raise ValueError(f"recording {path} cannot be read: {error}.") from error
    metres = _checked_metres(path, rate, _texts(point, "UNITS", 1)[0])
    positions = metres * np.transpose(np.asarray(data["points"], float)[:3], (2, 1, 0))
    positions[np.asarray(data["residuals"])[0].T < 0.0] = np.nan
    labels = _texts(point, "LABELS", positions.shape[1])
    events = zip(_texts(event, "LABELS", times.size), times.tolist(), strict=True)
    frames = np.arange(len(positions)) / rate
    return _recording(path, labels, frames, positions, tuple(events))


def _parts(group: Any, key: str) -> list[Any]:
    """Return what a key has; after 255 entries it goes on in KEY2, then KEY3."""
    keys = [key, *(f"{key}{n}" for n in range(2, 258))]
    return [group[k] for k in keys if k in group]


def _texts(group: Any, key: str, n: int) -> list[str]:
    texts = [escaped(text) for part in _parts(group, key) for text in part]
    return [*texts, *[""] * n][:n]


_AXES = ["X", "Y", "Z"]
_GAPS = {"", "nan", "null"}
"""What stands for a coordinate of a marker that was not seen, in lower case."""

_WORDS = {"Meters": "m", "Centimeters": "cm", "Millimeters": "mm", "Inches": "inch"}
_STATED_METRES = METRES | {word: METRES[unit] for word, unit in _WORDS.items()}
"""Units of length as the programs write them."""

_CELL = "a cell (blank, nan or NULL where a marker was not seen)"


class _Layout(NamedTuple):
    """What the lines above the numbers say.

    Each label, which may be blank, has the first of its three columns, and events have
    times [s]. The number in the `time_column`, or else the number of the row, over
    `rate` is the time in seconds.
    """

    labels: Sequence[tuple[str, int]]
    rows: NumberedCells
    unit: str | None
    time_column: int | None
    rate: float = 1.0
    events: tuple[tuple[str, float], ...] = ()


def _read_text(
    path: Path, length_unit: str | None, delimiter: str | None, decimal: str | None
) -> Recording:
    check_dialect(delimiter, decimal)
    rows, used = _rows_of(path, delimiter)
    if rows and "marker" in rows[0][1]:
        raise ValueError(
            f"{path} is a table of rows, with a column marker: take its rows by values "
            "of columns, not by a window of time."
        )
    reader = _reader_of(rows)
    if reader is None:
        raise ValueError(
            f"{path} is no table of motion capture that is known: expected a header "
            'that begins with "Format Version" (Motive), with "NO_OF_FRAMES" '
            '(Qualisys), or a section "Trajectories" (Vicon), or rows of numbers alone.'
        )
    read_layout, needed = reader
    try:
        layout = read_layout(rows)
    except (IndexError, KeyError, ValueError) as error:
        raise ValueError(
            f"{path} is not laid out as it begins ({error}): export {needed}."
        ) from error
    metres = _checked_metres(path, layout.rate, layout.unit, length_unit)
    point = decimal or decimal_of(layout.rows, used)
    times, positions = _numbers(path, layout, point)
    begin = times[0] if times.size else 0.0
    labels = [label for label, _ in layout.labels]
    events = tuple((name, time - begin) for name, time in layout.events)
    return _recording(path, labels, times - begin, metres * positions, events)


@once
def _rows_of(path: Path, delimiter: str | None) -> tuple[NumberedCells, str]:
    """Split a file into cells, by a given delimiter or else that of the header."""
    rows, used = read_cells(path, "recording", delimiter, 12)
    return [(number, cells) for number, cells in rows if any(cells)], used


def _checked_metres(
    path: Path, rate: float, stated: str | None, given: str | None = None
) -> float:
    """Check the rate of frames; return the unit of length, as stated or given [m]."""
    if not 0.0 < rate < math.inf:
        raise ValueError(f"{path}: its rate of frames is {rate:g}, not positive.")
    if given is not None:
        check_known("length unit", METRES, given)
    unit = given if stated is None else stated
    if unit is None:
        raise ValueError(
            f"{path} states no unit of length; give length_unit (Qualisys writes mm)."
        )
    if unit not in _STATED_METRES:
        raise ValueError(
            f"{path} states the unit of length {unit!r}; expected one of "
            f"{', '.join(_STATED_METRES)}, for all markers."
        )
    if given is not None and METRES[given] != _STATED_METRES[unit]:
        raise ValueError(
            f"{path} states the unit {unit!r}: leave length_unit = {given!r} out."
        )
    return _STATED_METRES[unit]


def _numbers(
    path: Path, layout: _Layout, point: str
) -> tuple[Float[HostArray, " n_frames"], Float[HostArray, "n_frames n_markers 3"]]:
    """Read times [s] and positions, nan where a marker was not seen."""
    columns = [first + k for _, first in layout.labels for k in range(3)]
    times = np.empty(len(layout.rows))
    values = np.full((len(layout.rows), len(columns)), np.nan)
    for i, (line, cells) in enumerate(layout.rows):
        # Spreadsheets leave out blank cells at the end of a row.
        cells = [*cells, *[""] * (max(columns, default=0) + 1 - len(cells))]
        with at_line(path, line):
            count = cells[layout.time_column] if layout.time_column is not None else i
            times[i] = parse_number(str(count), point) / layout.rate
            for k, column in enumerate(columns):
                if cells[column].lower() not in _GAPS:
                    values[i, k] = parse_number(cells[column], point, _CELL)
            before = times[i - 1] if i else -math.inf
            if not before < times[i] < math.inf:
                raise ValueError(
                    f"its time, {times[i]:g} s, is not after that of the frame before, "
                    f"{before:g} s."
                )
    return times, values.reshape(len(times), -1, 3)


def _starts(rows: NumberedCells) -> list[str]:
    return [cells[0] for _, cells in rows]


def _motive(rows: NumberedCells) -> _Layout:
    """Read the header of Motive: types, names, IDs, what each column is, and axes."""
    about, header = rows[0][1], _starts(rows).index("Frame")
    # Rows between: types, names, in most versions IDs and parents, quantities.
    (_, types), (_, names), *_, (_, whats) = rows[1:header]
    axes = rows[header][1]
    cells = itertools.zip_longest(types, names, whats, fillvalue="")
    labels = [
        (name, k)
        for k, (kind, name, what) in enumerate(cells)
        if (kind, what) == ("Marker", "Position") and axes[k : k + 3] == _AXES
    ]
    if not labels:
        kinds = ", ".join(sorted({*types} - {"Type", ""}))
        raise ValueError(f"it has no measured markers, only {kinds}")
    return _Layout(
        labels=labels,
        rows=rows[header + 1 :],
        unit=dict(zip(about[::2], about[1::2], strict=False))["Length Units"],
        time_column=axes.index("Time (Seconds)"),
    )


def _vicon(rows: NumberedCells) -> _Layout:
    """Read the header of the section Trajectories: rate, labels, axes, units."""
    start = _starts(rows).index("Trajectories")
    (_, rate), (_, names), (_, axes), (_, units) = rows[start + 1 : start + 5]
    of_markers = [k for k in range(len(axes)) if axes[k : k + 3] == _AXES]
    labels = [("".join(names[k : k + 1]), k) for k in of_markers]
    stated = {unit for _, k in labels for unit in units[k : k + 3]}
    frames = rows[start + 5 :]
    # Another section may follow.
    end = next((i for i, (_, c) in enumerate(frames) if not c[0].isdecimal()), None)
    return _Layout(
        labels=labels,
        rows=frames[:end],
        unit=", ".join(sorted(stated)),
        time_column=0,
        rate=float(rate[0]),
    )


def _qualisys(rows: NumberedCells) -> _Layout:
    """Read the header of QTM: names and values, and perhaps names of columns."""
    last = _starts(rows).index("MARKER_NAMES")
    about = {cells[0]: cells[1:] for _, cells in rows[: last + 1]}
    if about["DATA_INCLUDED"][0] != "3D":
        raise ValueError(f"it includes {about['DATA_INCLUDED'][0]} data")
    labels = about["MARKER_NAMES"][: int(about["NO_OF_MARKERS"][0])]
    rest = [row for row in rows[last + 1 :] if row[1][0] != "TRAJECTORY_TYPES"]
    titles = rest[0][1] if rest else []
    title = f"{labels[0] if labels else ''} X".strip()
    if title in titles:
        first, rest = titles.index(title), rest[1:]
    else:  # a tab may end the row
        first = (len(titles) - 3 * len(labels)) // 2 * 2
    if first not in (0, 2):  # there may be Frame and Time before
        raise ValueError(f"it has {len(titles)} columns for {len(labels)} markers")
    timed = first == 2
    return _Layout(
        labels=[(label, first + 3 * i) for i, label in enumerate(labels)],
        rows=rest,
        unit=None,
        time_column=1 if timed else None,
        rate=1.0 if timed else float(about["FREQUENCY"][0].replace(",", ".")),
        events=tuple(
            (cells[1], float(cells[3].replace(",", ".")))
            for _, cells in rows[:last]
            if cells[0] == "EVENT" and len(cells) > 3
        ),
    )


def _plain(rows: NumberedCells) -> _Layout:
    """Take columns by place: perhaps the frame, the time, then those of the markers."""
    n = len(rows[0][1])
    n_markers, before = divmod(n, 3)
    if not (n_markers and before):
        raise ValueError(f"it has {n} columns")
    return _Layout(
        labels=[(str(i + 1), before + 3 * i) for i in range(n_markers)],
        rows=rows,
        unit=None,
        time_column=before - 1,
    )


_Reader = tuple[Callable[[NumberedCells], _Layout], str]
"""What reads a layout, and what to export for it."""

_LAYOUTS: dict[str, _Reader] = {
    "Format Version": (_motive, "Markers with the header and times from Motive"),
    "NO_OF_FRAMES": (_qualisys, "3D data with the TSV header from QTM"),
    "Trajectories": (_vicon, "Trajectories with their four rows from Nexus"),
}
"""Readers by how a row near the top of a table begins."""

_PLAIN: _Reader = _plain, "the time, after the frame or not, then x, y, z by marker"
_NUMBER = re.compile(r"[-+]?\d+([.,]\d*)?(e[-+]?\d+)?", re.IGNORECASE)


def _reader_of(rows: NumberedCells) -> _Reader | None:
    """Return how a table is read; one without a header begins with numbers and gaps."""
    first, *others = rows[0][1] if rows else [""]
    numbers = (cell.lower() in _GAPS or _NUMBER.fullmatch(cell) for cell in others)
    if _NUMBER.fullmatch(first) and all(numbers):
        return _PLAIN
    starts = _starts(rows)
    return next((_LAYOUTS[row] for row in _LAYOUTS if row in starts), None)
