"""Recordings of motion capture: positions of labelled markers over time."""

import os
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import numpy as np

from softcal_jax._files import check_file
from softcal_jax._names import METRES, suggestion
from softcal_jax._text import escaped
from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations._marker_table import MarkerTable

STEP = 0.05
"""Share of the largest motion of a marker from which it has begun to move [-]."""


class Recording(eqx.Module):
    """Positions of markers over time, in the frame of the cameras.

    Attributes:
        names: Labels of the markers.
        times: Time of each frame from the first one [s].
        positions: Positions; nan where a marker was occluded [m].
        source: What was read, for messages.
    """

    names: tuple[str, ...]
    times: Float[HostArray, " n_frames"]
    positions: Float[HostArray, "n_frames n_markers 3"]
    source: str

    def step_of(self, name: str) -> float:
        """Return the time at which a marker begins to move [s].

        That is its first frame in which it is farther from where it was first seen than
        a twentieth of its largest distance from there. A recording that begins at rest
        and in which a valve opens or a weight is put on has one such step.

        Raises:
            ValueError: If there is no such marker, or it does not move.
        """
        path = self.positions[:, self._column(name)]
        seen = np.flatnonzero(np.isfinite(path).all(axis=1))
        away = np.linalg.norm(path[seen] - path[seen[:1]], axis=1)
        if not np.any(away > 0.0):
            raise ValueError(f"{self.source}: marker {name!r} does not move.")
        return float(self.times[seen[np.argmax(away > STEP * away.max())]])

    def between(
        self, start: float, stop: float, *, after_step_of: str | None = None
    ) -> MarkerTable:
        """Return mean positions over a window of time, of the frames that see a marker.

        Args:
            start: Begin of the window [s].
            stop: End of the window [s].
            after_step_of: Marker from whose step, see `step_of`, both are counted; from
                the first frame by default. Negative times are then before the step.

        Raises:
            ValueError: If the window is not in the recording, or holds no frame.
        """
        zero = 0.0 if after_step_of is None else self.step_of(after_step_of)
        # Times are multiples of the frame's length, up to rounding.
        slack = 1e-6 * (self.times[1] - self.times[0]) if len(self.times) > 1 else 0.0
        since = self.times - zero
        inside = (since >= start - slack) & (since <= stop + slack)
        window = f"between {start:g} and {stop:g} s"
        if after_step_of is not None:
            window += f" from the step of {after_step_of!r}"
        out = start < since[0] - slack or stop > since[-1] + slack
        if out or not np.any(inside):
            raise ValueError(
                f"{self.source}: there are not all frames {window}; it has those "
                f"between {since[0]:g} and {since[-1]:g} s."
            )
        part = self.positions[inside]
        seen = np.all(np.isfinite(part), axis=2)
        total = np.sum(np.where(seen[:, :, None], part, 0.0), axis=0)
        count = np.sum(seen, axis=0)
        count = np.where(count > 0, count, np.nan)
        return MarkerTable(
            names=self.names,
            positions=total / count[:, None],
            places=(window,) * len(self.names),
            source=self.source,
        )

    def _column(self, name: str) -> int:
        if name not in self.names:
            raise ValueError(
                f"{self.source} has no marker {name!r}.{suggestion(name, self.names)} "
                f"It has {', '.join(self.names)}."
            )
        return self.names.index(name)


def read_c3d(path: str | os.PathLike[str]) -> Recording:
    """Read a recording of motion capture, with the units that the file states.

    A frame in which a marker has a negative residual did not see it.

    Args:
        path: A file in the format of www.c3d.org.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If ezc3d is not installed.
        ValueError: If it is no file of a disk, cannot be read, holds no frames or no
            markers, or two markers of one label, or does not state a known unit of
            length.

    Example:
        The pose from 1.25 to 1.35 s after the valve opened::

            arm = read_c3d("200mbar.c3d")
            arm.between(1.25, 1.35, after_step_of="Tip - 1").positions_of(["Tip - 1"])
    """
    try:
        import ezc3d
    except ImportError as error:
        raise ImportError(
            "reading .c3d files needs ezc3d: pip install 'softcal-jax[mocap]'."
        ) from error
    path = Path(path)
    check_file(path, "recording")
    try:
        content = ezc3d.c3d(str(path))
    except (OSError, RuntimeError, ValueError) as error:
        raise ValueError(f"recording {path} cannot be read: {error}.") from error
    point = content["parameters"]["POINT"]
    names = tuple(map(escaped, point["LABELS"]["value"]))
    units = point["UNITS"]["value"] if "UNITS" in point else []
    _check(path, names, units)
    positions = np.moveaxis(np.asarray(content["data"]["points"], float), 2, 0)
    positions = np.swapaxes(positions, 1, 2)[:, : len(names), :3] * METRES[units[0]]
    residuals = np.asarray(content["data"]["meta_points"]["residuals"])[0].T
    positions[residuals[:, : len(names)] < 0.0] = np.nan
    rate = float(point["RATE"]["value"][0])
    if not (len(positions) and rate > 0.0):
        raise ValueError(
            f"recording {path} has {len(positions)} frames at {rate:g} Hz; expected "
            "one or more, and a positive rate."
        )
    times = np.arange(len(positions)) / rate
    return Recording(names=names, times=times, positions=positions, source=str(path))


def _check(path: Path, names: Sequence[str], units: Sequence[str]) -> None:
    if not names:
        raise ValueError(f"recording {path} holds no labelled markers.")
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise ValueError(f"recording {path} has the label {repeated[0]!r} twice.")
    if not units or units[0] not in METRES:
        stated = repr(units[0]) if units else "none"
        raise ValueError(
            f"recording {path} states the unit of length {stated}; expected one of "
            f"{', '.join(METRES)} in its parameter POINT:UNITS."
        )
