"""Tables of a project file for markers, and when and where they were measured."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, StrictBool, model_validator

from softcal_jax._files import once
from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import STD, Markers, Unstated
from softcal_jax.project import _quantities as typed
from softcal_jax.project._sensors import DialectTable, Measured, Selection
from softcal_jax.project._table import (
    Choice,
    File,
    Table,
    TableOr,
    known_name,
    table_of,
    under,
)
from softcal_jax.readings import (
    MarkerTable,
    Recording,
    Registration,
    Traces,
    is_recording,
    read_markers,
    read_recording,
    register,
)

_KINDS = ("between", "at", "plateau")
"""What a window of time is given by; each has a method of `Recording`."""


class WindowTable(Table):
    """A window of time of a recording, over which positions are averaged.

    It lies `between` two times, has a `width` around the time `at`, or is a `plateau`
    of at least that length, which is searched for. Times count from the step of a
    marker or from an event of the file, if one is named.
    """

    between: tuple[typed.Time, typed.Time] | None = None
    at: typed.Time | None = None
    width: typed.Time | None = None
    plateau: typed.Time | None = None
    after_step_of: str | None = None
    after_event: str | None = None

    @model_validator(mode="after")
    def _check(self) -> "WindowTable":
        given = [key for key in _KINDS if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(
                f"got {' and '.join(given) or 'no time'}; expected one of between = "
                '["1.2 s", "1.4 s"], at = "1.3 s", plateau = "0.5 s". A key of '
                "[shared] holds as well: where configurations differ in it, give each "
                "its own."
            )
        if self.width is not None and self.at is None:
            raise ValueError("width is for the window around `at`.")
        return self

    def of(self, recording: Recording) -> MarkerTable:
        after = self.model_dump(include={"after_step_of", "after_event"})
        if self.between is not None:
            return recording.between(*self.between, **after)
        if self.plateau is not None:
            return recording.plateau(self.plateau, **after)
        assert self.at is not None
        width = {} if self.width is None else {"width": self.width}
        return recording.at(self.at, **width, **after)


def _which(value: Any, kinds: Sequence[Any]) -> Any:
    """Choose a window, or values of columns, which may be named like its keys."""
    if isinstance(value, dict) and {*_KINDS} & {*value}:
        others = {*value} - {*WindowTable.model_fields}
        if not others or isinstance(value.get("between"), list):
            return WindowTable
    return kinds[-1] if isinstance(value, str) else Selection


Which = Annotated[WindowTable | Selection, Choice(_which)]
"""What is taken of a file: a window of a recording, or rows of a table."""

_read_once = once(read_recording)

CameraAxis = Literal["x", "y", "z", "-x", "-y", "-z"]

WhichOrName = Annotated[WindowTable | Selection | str, Choice(_which)]


class MarkerEntry(Table):
    """A marker with a standard deviation of its own."""

    position: typed.Position = Field(description='"(0, 15, 36) mm"')
    std: typed.PositiveLength | None = None


class MarkersTable(table_of(Markers, "names", "positions", "std")):
    """Positions of the markers at rest, in the frame of the mesh."""

    positions: dict[str, TableOr[MarkerEntry, typed.Position]] = Field(
        description="names and positions of the markers"
    )
    std: typed.PositiveLength | None = None

    def build(self, names: Sequence[str] | None) -> Markers:
        """Build the named markers, or all if `names` is None."""
        names = tuple(self.positions) if names is None else tuple(names)
        if not names:
            raise ValueError("the list of markers is empty; leave it out to use all.")
        positions = self.positions_of(names)
        entries = [self.positions[name] for name in names]
        stds = [getattr(entry, "std", None) or self.std or STD for entry in entries]
        stated = {} if all(std is STD for std in stds) else {"std": np.array(stds)}
        return super().build(names, positions, **stated)

    def positions_of(self, names: Sequence[str]) -> Float[HostArray, "n_markers 3"]:
        """Return positions of some markers at rest [m]."""
        for name in names:
            known_name("marker", name, self.positions, "[markers.positions]")
        entries = [self.positions[name] for name in names]
        places = [e.position if isinstance(e, MarkerEntry) else e for e in entries]
        return np.array(places, float).reshape(-1, 3)


class RegistrationTable(Table):
    """How to register the frame of the cameras to the frame of the mesh.

    With `axes` the frames are known to be turned so: the axes of the cameras along x,
    y and z of the mesh. One marker is enough then.
    """

    markers: tuple[str, ...] = Field(description='markers to fit: ["4", "5", "6"]')
    axes: tuple[CameraAxis, CameraAxis, CameraAxis] | None = None
    select: Which = Field(default_factory=dict)

    def rotation(self) -> Float[HostArray, "3 3"] | None:
        """Return the rotation from axes of the cameras to those of the mesh [-]."""
        if self.axes is None:
            return None
        signs = [-1.0 if axis.startswith("-") else 1.0 for axis in self.axes]
        R = np.diag(signs) @ np.eye(3)[["xyz".index(axis[-1]) for axis in self.axes]]
        if not np.isclose(np.linalg.det(R), 1.0):
            raise ValueError(
                f"axes {', '.join(self.axes)} are no turn of a right-handed frame: "
                "name x, y and z once each, with signs that do not mirror it."
            )
        return R


class MeasuredMarkers(NamedTuple):
    """The markers of a configuration, and what was measured of them.

    Their `std` includes the scatter of a recording if asked, and `positions` are in the
    frame of the mesh [m]. The `traces` are those of the recording, if there is one.
    """

    markers: Markers | None = None
    positions: Float[HostArray, "n_markers 3"] | None = None
    registration: Registration | None = None
    traces: Traces | None = None


class MeasuredTable(DialectTable):
    """Where to read measured positions, and how to bring them into the mesh's frame.

    `effectors` holds measured values beside markers. `displacement_from` is the name of
    a configuration, or selects the state before the motion in the same file. `labels`
    are labels of the file by names of the project. With `scatter`, the scatter of a
    recording over its windows is added to the standard deviations.
    """

    file: File | None = None
    labels: dict[str, str] = Field(default_factory=dict)
    recording: Selection = Field(default_factory=dict)
    select: Which = Field(default_factory=dict)
    registration: RegistrationTable | None = None
    displacement_from: WhichOrName | None = None
    scatter: StrictBool = False
    effectors: dict[str, Measured] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> "MeasuredTable":
        others = {"file", "effectors"}
        if isinstance(self.displacement_from, str):
            others |= {"displacement_from"}  # a name is for effectors too
        given = sorted(self.model_fields_set - others)
        if self.file is None and (given or not self.effectors):
            which = f"{given[0]} is for the file of the markers; " if given else ""
            raise ValueError(f'{which}expected file = "markers.csv", or `effectors`.')
        if self.recording and isinstance(self.select, WindowTable):
            raise ValueError("`recording` is for rows, a window for a file over time.")
        return self

    def _which(self) -> dict[str, WindowTable | Selection]:
        """Return the windows and selections of the file, by key."""
        every = {"select": self.select, "displacement_from": self.displacement_from}
        if self.registration is not None:
            every["registration.select"] = self.registration.select
        # `displacement_from` may also name a configuration, which is left out here.
        return {k: w for k, w in every.items() if isinstance(w, WindowTable | dict)}

    def _read_rows(self, key: str, select: Any) -> MarkerTable:
        assert self.file is not None
        select = self.recording | select
        try:
            return read_markers(self.file, select=select, **self.dialect)
        except ValueError as error:
            if not is_recording(self.file):
                raise
            raise ValueError(
                f"{self.file} is a recording over time: `{key}` says when, as in "
                '{ between = ["1.2 s", "1.4 s"] }.'
            ) from error

    def _read_recording(self, needed: Sequence[str]) -> Recording:
        """Read a recording, with markers under the names that the project has."""
        recording = _read_once(self.file, **self.dialect)
        labels = {
            name: label
            for name, label in self.labels.items()
            if label in recording.names or name in needed
        }
        with under("labels"):
            return recording.renamed(labels)

    def build(self, nominal: MarkersTable, markers: Markers) -> MeasuredMarkers:
        """Read positions of `markers` [m] in the mesh's frame; `nominal` lists all.

        With a selection as `displacement_from` they are the nominal positions plus the
        motion between the two states, so that it does not matter exactly where a marker
        was glued. With the name of a configuration they are as read: the calibration
        compares displacements from that configuration.
        """
        for name in self.labels:
            with under("labels"):
                nominal.positions_of([name])  # raises if there is no such marker
        names, recording = markers.names, None
        if any(isinstance(which, WindowTable) for which in self._which().values()):
            fixed = () if self.registration is None else self.registration.markers
            recording = self._read_recording((*names, *fixed))
        windows = {
            key: which.of(recording)
            if recording is not None and isinstance(which, WindowTable)
            else self._read_rows(key, which)
            for key, which in self._which().items()
        }
        loaded = self._positions(windows["select"], names)
        start, registration, R = None, None, np.eye(3)
        if "displacement_from" in windows:
            start = self._positions(windows["displacement_from"], names)
        if self.registration is not None:
            fitted = self.registration.markers
            seen = self._positions(windows["registration.select"], fitted)
            places, turn = nominal.positions_of(fitted), self.registration.rotation()
            registration = register(seen, places, rotation=turn)
            loaded, R = registration.apply(loaded), registration.rotation
            start = None if start is None else registration.apply(start)
        if start is not None:
            loaded = markers.positions + (loaded - start)
        traces = None
        if self.scatter:
            parts = [key for key in windows if key != "registration.select"]
            seen = [windows[key].covariances_of(names) for key in parts]
            std = _with_scatter(markers, R @ np.sum(seen, axis=0) @ R.T)
            markers = replace(markers, std=std)
        if recording is not None:
            times = {k: t.window for k, t in windows.items() if t.window}
            traces = Traces(recording, times, names)
        return MeasuredMarkers(markers, loaded, registration, traces)

    def _positions(
        self, table: MarkerTable, names: Sequence[str]
    ) -> Float[HostArray, "n_wanted 3"]:
        """Return positions by names of the project; a recording already uses these."""
        if table.window is not None:
            return table.positions_of(names)
        return table.positions_of([self.labels.get(name, name) for name in names])


def _with_scatter(
    markers: Markers, covariances: Float[HostArray, "n_markers 3 3"]
) -> Float[HostArray, "n_markers 3"]:
    """Add scatter, in the frame of the mesh, to the stated standard deviations."""
    scatter = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    if isinstance(markers.std, Unstated):
        still = [n for n, s in zip(markers.names, scatter, strict=True) if not s.all()]
        if still:
            raise ValueError(
                f"marker {still[0]!r} does not scatter over its window, so that this "
                "says nothing of its noise: state std of the markers."
            )
        return scatter
    stated = np.asarray(markers.std, float)
    stated = stated[:, None] if stated.ndim == 1 else stated
    return np.hypot(stated, scatter)
