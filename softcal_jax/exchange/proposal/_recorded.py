"""Poses from files of markers, and all that a project is written from."""

import math
import re
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softcal_jax import readings
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import METRES
from softcal_jax.exchange.proposal._body import Actuated, Body, Held
from softcal_jax.project import recognised, toml_value
from softcal_jax.readings import MarkerTable

_REST = re.compile(
    r"(?<![a-z])(rest|unloaded|zero|reference|initial|home)(?![a-z])"
    r"|^\W*0(\.0+)?(?![\d.,])",
    re.IGNORECASE,
)
"""Names of poses in which nothing acts but gravity."""

_QUANTITY = re.compile(r"(?<![\d.])([+-]?\d+(?:\.\d+)?)[ _]?([a-zA-Z]+)(?![a-zA-Z\d])")
"""What may act, in a name or a cell: "15 kPa". Its unit may end the name of a column:
"pressure_kPa", "force [N]"."""

_OF_PLACE = {*"xyz", *(f"{axis}_{unit}" for axis in "xyz" for unit in METRES)}
"""Columns with coordinates."""


class Stated(NamedTuple):
    """A quantity that acts in a pose: as text and in SI, and what says so."""

    text: str
    value: float
    unit: str
    source: str


class RecordedPose(NamedTuple):
    """A pose that was recorded, and the positions of markers in it by label [m].

    `select` is what a project file takes of the file, as TOML.
    """

    name: str
    file: Path
    select: str
    seen: dict[str, Float[HostArray, "3"]]
    stated: tuple[Stated, ...] = ()

    @property
    def is_unloaded(self) -> bool:
        """Whether its name, or all that is stated of it, says that nothing acts."""
        if self.stated:
            return not any(stated.value for stated in self.stated)
        return _REST.search(self.name) is not None


class Recorded(NamedTuple):
    """The poses of one or several files, or of recordings over time.

    `rest` is a guess, and so is `unit`, which is None if the files state one.
    """

    rest: RecordedPose
    others: tuple[RecordedPose, ...]
    over_time: bool
    unit: str | None

    @property
    def labels(self) -> list[str]:
        """Labels of the markers that were seen at rest."""
        return [*self.rest.seen]

    @property
    def positions(self) -> Float[HostArray, "n_markers 3"]:
        """Positions at rest, in the frame of the file [m]."""
        return np.array([*self.rest.seen.values()]).reshape(-1, 3)

    @property
    def moving(self) -> Float[HostArray, "n 3"] | None:
        """Positions at rest of markers that move at least half as far as any [m]."""
        far = self._motions
        return self.positions[far >= 0.5 * far.max()] if far.any() else None

    def stillest(self, n: int) -> list[str]:
        """Return the labels of the `n` markers that move least, in their order."""
        chosen = np.sort(np.argsort(self._motions, kind="stable")[:n])
        return [self.labels[i] for i in chosen]

    @property
    def _motions(self) -> Float[HostArray, " n_markers"]:
        """Longest distance that each marker moves from rest [m]."""
        far = np.zeros(len(self.labels))
        for pose in self.others:
            for i, (name, place) in enumerate(self.rest.seen.items()):
                if name in pose.seen:
                    far[i] = max(far[i], np.linalg.norm(pose.seen[name] - place))
        return far


class MarkerPlace(NamedTuple):
    """Where a marker is put, and how far from the mesh it was recorded [m]."""

    name: str
    place: Float[HostArray, "3"]
    distance: float


class Findings(NamedTuple):
    """What a project is written from.

    The model is named as in the project file, and a load is proposed to act at `tip`
    [m]. `own_frame` says whether the recording has another frame than the mesh.
    """

    model: str
    body: Body
    held: Held
    tip: Float[HostArray, "3"]
    actuated: tuple[Actuated, ...]
    recorded: Recorded | None
    own_frame: bool
    markers: tuple[MarkerPlace, ...]

    @property
    def poses(self) -> tuple[RecordedPose, ...]:
        """All poses that were recorded, the one at rest first."""
        recorded = self.recorded
        return () if recorded is None else (recorded.rest, *recorded.others)


def read_recorded(paths: Sequence[Path], across: float) -> Recorded:
    """Read the poses of a table of rows, or of recordings over time, a pose in each.

    The size `across` of the robot [m] serves to guess a unit that no file states.
    """
    kinds = [readings.is_recording(path) for path in paths]
    over_time = all(kinds)
    if len(paths) > 1 and not over_time:
        raise ValueError(
            f"{paths[kinds.index(False)]} is a table of rows, which holds all poses: "
            "give it alone, or several recordings over time."
        )
    find = _ends if over_time else _rows
    try:
        poses, unit = find(paths, None), None
    except ValueError as refused:
        try:
            poses = find(paths, "m")
        except ValueError:
            raise refused from None
        unit = _likely_unit(poses[0], across)
        poses = find(paths, unit)
    rest = next((pose for pose in poses if pose.is_unloaded), poses[0])
    if not rest.seen:
        raise ValueError(
            f"{rest.file}: no marker was seen in {rest.name!r}, with which the other "
            "poses are compared."
        )
    others = tuple(pose for pose in poses if pose is not rest)
    return Recorded(rest, others, over_time, unit)


def _likely_unit(pose: RecordedPose, across: float) -> str:
    """Return the unit in which markers lie as far apart as a robot of that size."""
    places = np.array([*pose.seen.values()]).reshape(-1, 3)
    apart = float(np.ptp(places, axis=0).max()) if len(places) > 1 else 0.0
    apart = apart or float(np.abs(places).max(initial=0.0)) or across
    off = lambda unit: abs(np.log(apart * METRES[unit] / across))
    return min("mm", "cm", "m", key=off)


def _rows(paths: Sequence[Path], unit: str | None) -> list[RecordedPose]:
    """Read the poses of a table of rows, by the columns that tell them apart."""
    (path,) = paths
    table = readings.read_table(path, "marker")
    rows = [dict(zip(table.header, cells, strict=True)) for _, cells in table.rows]
    columns = _columns(table.header, rows)
    others = [c for c in table.header if c not in {"marker", *_OF_PLACE}]
    poses = {}
    for row in rows:
        select = {c: row[c] for c in columns}
        if (key := toml_value(select)) in poses:
            continue
        seen = _seen(readings.read_markers(path, length_unit=unit, select=select))
        ends = {c: re.split(r"[^a-zA-Z0-9]+", c.strip(")]"))[1:][-1:] for c in others}
        said = {f"the column {c}": " ".join([row[c], *ends[c]]) for c in others}
        name = " ".join(select.values()) or "pose"
        poses[key] = RecordedPose(name, path, key, seen, _stated(said))
    return [*poses.values()]


def _stated(said: Mapping[str, str]) -> tuple[Stated, ...]:
    """Find quantities in texts, by their sources."""
    return tuple(
        Stated(f"{number} {unit}", read[0][0], read[1], source)
        for source, words in said.items()
        for number, unit in _QUANTITY.findall(words.replace(",", "."))
        if (read := recognised(f"{number} {unit}"))
    )


def _columns(header: Sequence[str], rows: Sequence[Mapping[str, str]]) -> tuple:
    """Choose the fewest columns, with the fewest values, that tell poses apart.

    In a pose every marker has one row. If no columns tell poses apart, none are chosen,
    and reading reports which marker occurs twice.
    """
    others = [column for column in header if column not in {"marker", *_OF_PLACE}]
    distinct = lambda columns: len({tuple(row[c] for c in columns) for row in rows})
    for n in range(min(3, len(others)) + 1):
        telling = [
            columns
            for columns in combinations(others, n)
            if distinct((*columns, "marker")) == len(rows)
        ]
        if telling:
            return min(telling, key=distinct)
    return ()


def _ends(paths: Sequence[Path], unit: str | None) -> list[RecordedPose]:
    """Take 0.1 s at the start of the first recording as rest, at each end as a pose."""
    poses = []
    for path in paths:
        recording = readings.read_recording(path, length_unit=unit)
        # Rounded down, the end does not lie behind the last frame.
        last = math.floor(1e4 * float(recording.times[-1])) / 1e4
        width = min(0.1, last)
        windows = [("rest", 0.0, width), (path.stem, last - width, last)]
        if poses:
            windows = windows[1:]
        elif last <= 2.0 * width or path.stem == "rest":  # nothing but rest in it
            windows = windows[:1]
        for name, start, stop in windows:
            listed = ", ".join(f'"{round(time, 4):.10g} s"' for time in (start, stop))
            seen = _seen(recording.between(round(start, 4), round(stop, 4)))
            select = f"{{ between = [{listed}] }}"
            stated = _stated({"its name": name})
            poses.append(RecordedPose(name, path, select, seen, stated))
    return poses


def _seen(table: MarkerTable) -> dict[str, Float[HostArray, "3"]]:
    pairs = zip(table.names, table.positions, strict=True)
    return {name: place for name, place in pairs if np.isfinite(place).all()}
