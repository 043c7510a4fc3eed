"""Tables of a project file that make markers and their measured positions."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import (
    STD,
    Markers,
    MarkerTable,
    Registration,
    read_c3d,
    read_markers,
    register,
)
from softcal_jax.project._effectors import Measured
from softcal_jax.project._mesh import LengthUnit
from softcal_jax.project._problems import known_here
from softcal_jax.project._sensors import Selection
from softcal_jax.project._table import (
    Length,
    Position,
    PositiveLength,
    Table,
    TableOr,
    Time,
)


class MarkerEntry(Table):
    """A marker with a standard deviation of its own."""

    position: Position = Field(description='"(0, 15, 36) mm"')
    std: PositiveLength | None = None


class MarkersTable(Table):
    """Positions of the markers at rest, in the frame of the mesh."""

    positions: dict[str, TableOr[MarkerEntry, Position]] = Field(
        description="names and positions of the markers"
    )
    std: PositiveLength | None = None
    axes: str = "xyz"
    max_distance: Length = 0.01
    base_radius: Length = 0.0

    def build(self, names: Sequence[str] | None) -> Markers:
        """Build the named markers, or all if `names` is None."""
        names = tuple(self.positions) if names is None else tuple(names)
        if not names:
            raise ValueError("the list of markers is empty; leave it out to use all.")
        own = [self._entry(name).std for name in names]
        every = self.std is not None or any(std is not None for std in own)
        usual = STD if self.std is None else self.std
        stated = {"std": np.array([usual if s is None else s for s in own])}
        return Markers(
            names=names,
            positions=self.positions_of(names),
            **(stated if every else {}),
            **self.model_dump(include={"axes", "max_distance", "base_radius"}),
        )

    def positions_of(self, names: Sequence[str]) -> Float[HostArray, "n_markers 3"]:
        """Return positions of some markers at rest [m]."""
        entries = map(self._entry, names)
        return np.array([entry.position for entry in entries], float).reshape(-1, 3)

    def _entry(self, name: str) -> MarkerEntry:
        if name not in self.positions:
            known = known_here(name, self.positions)
            raise ValueError(f"unknown marker {name!r}.{known}")
        own = self.positions[name]
        full = isinstance(own, MarkerEntry)
        return own if full else MarkerEntry.model_construct(position=own)


class WindowTable(Table):
    """A window of time of a recording, over which positions are averaged."""

    between: tuple[Time, Time] = Field(description='["1.2 s", "1.4 s"]')
    after_step_of: str | None = Field(
        None, description="marker from whose step the times are counted"
    )


def _is_window(value: object) -> bool:
    return isinstance(value, dict) and isinstance(value.get("between"), list)


Which = Annotated[
    Annotated[WindowTable, Tag("(window)")] | Annotated[Selection, Tag("(rows)")],
    Discriminator(lambda value: "(window)" if _is_window(value) else "(rows)"),
]
"""What is taken of a file: a window of a recording, or rows of a table."""

RECORDING = ".c3d"
"""How the names of recordings end."""


class RegistrationTable(Table):
    """How to register the frame of the cameras to the frame of the mesh."""

    markers: tuple[str, ...] = Field(description='markers to fit: ["4", "5", "6"]')
    select: Which = Field(default_factory=dict)


class MeasuredTable(Table):
    """Where to read measured positions, and how to bring them into the mesh's frame.

    `effectors` holds measured values of other effectors. `displacement_from` is the
    name of a configuration, or rows of the same file as those before the motion.
    """

    file: str | None = None
    length_unit: LengthUnit | None = None
    recording: Selection = Field(default_factory=dict)
    select: Which = Field(default_factory=dict)
    registration: RegistrationTable | None = None
    displacement_from: Which | str | None = None
    effectors: dict[str, Measured] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> "MeasuredTable":
        others = {"file", "effectors"}
        if isinstance(self.displacement_from, str):
            others |= {"displacement_from"}  # of all that has points or a frame
        given = sorted(self.model_fields_set - others)
        if self.file is None and (given or not self.effectors):
            which = f"{given[0]} is for the file of the markers; " if given else ""
            raise ValueError(
                f'{which}expected file = "markers.csv", or `effectors` with what was '
                "measured beside markers."
            )
        if self.file is not None:
            self._check_kind(self.file)
        return self

    def _check_kind(self, file: str) -> None:
        """Raise ValueError unless a recording has windows, and a table none."""
        recorded = file.lower().endswith(RECORDING)
        every = {"select": self.select, "displacement_from": self.displacement_from}
        if self.registration is not None:
            every["registration.select"] = self.registration.select
        for key, which in every.items():
            if which is None or isinstance(which, str):
                continue  # or the name of a configuration
            if isinstance(which, WindowTable) == recorded:
                continue
            if recorded:
                raise ValueError(
                    f"{file} is a recording: `{key}` says when, as in {{ between = "
                    '["1.2 s", "1.4 s"] }.'
                )
            raise ValueError(
                f"{file} is a table of rows: `{key}` names values of its columns, not "
                "a window of time."
            )
        for key in ("recording", "length_unit"):
            if recorded and key in self.model_fields_set:
                raise ValueError(
                    f"`{key}` is for tables; {file} is one recording, which states its "
                    "unit of length."
                )

    def _read(self, path: Path, which: WindowTable | Selection) -> MarkerTable:
        if isinstance(which, WindowTable):
            start, stop = which.between
            recording = read_c3d(path)
            return recording.between(start, stop, after_step_of=which.after_step_of)
        select = {**self.recording, **which}
        return read_markers(path, length_unit=self.length_unit, select=select)

    def build(
        self, folder: Path, nominal: MarkersTable, markers: Markers
    ) -> tuple[Float[HostArray, "n_markers 3"], Registration | None]:
        """Read positions of `markers` in the frame of the mesh; `nominal` are all [m].

        With a selection as `displacement_from` they are the nominal positions plus the
        motion between the two states, so that it does not matter exactly where a marker
        was glued. With the name of a configuration they are as read: the calibration
        compares displacements from that one.
        """

        def read(which: WindowTable | Selection, names: Sequence[str]):
            return self._read(folder / str(self.file), which).positions_of(names)

        loaded, start, registration = read(self.select, markers.names), None, None
        reference = self.displacement_from
        if reference is not None and not isinstance(reference, str):
            start = read(reference, markers.names)
        if self.registration is not None:
            names = self.registration.markers
            seen = read(self.registration.select, names)
            registration = register(seen, nominal.positions_of(names))
            loaded = registration.apply(loaded)
            start = None if start is None else registration.apply(start)
        if start is not None:
            loaded = markers.positions + (loaded - start)
        return loaded, registration
