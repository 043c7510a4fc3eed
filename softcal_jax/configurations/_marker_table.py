"""Positions of markers from a file, and their registration to the frame of the mesh."""

import os
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import ArrayLike
from scipy.spatial.transform import Rotation

from softcal_jax._module import Module
from softcal_jax._names import suggestion
from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations._csv_table import coordinates, read_table


class Registration(Module):
    """A rigid motion fitted to markers that are known in both frames.

    Attributes:
        rotation: Rotation matrix, camera axes to mesh axes [-].
        translation: Translation after the rotation [m].
        residuals: Residual of each marker used, in the mesh frame [m].
    """

    rotation: Float[HostArray, "3 3"]
    translation: Float[HostArray, "3"]
    residuals: Float[HostArray, "n_used 3"]

    @property
    def rms(self) -> float:
        """Root mean square of the residual distances [m]."""
        return float(np.sqrt(np.mean(np.sum(self.residuals**2, axis=1))))

    def apply(
        self, points: Float[ArrayLike, "n_points 3"]
    ) -> Float[HostArray, "n_points 3"]:
        """Move points from the camera frame to the mesh frame [m]."""
        return np.asarray(points, float) @ self.rotation.T + self.translation


def register(
    measured: Float[ArrayLike, "n_markers 3"], nominal: Float[ArrayLike, "n_markers 3"]
) -> Registration:
    """Fit the rigid motion that takes measured markers onto nominal positions.

    The least-squares rotation of Kabsch (Acta Cryst. A32, 1976), by
    `scipy.spatial.transform.Rotation.align_vectors`. Positions are `measured` in the
    camera frame and `nominal` in the mesh frame [m].

    Raises:
        ValueError: If there are not three finite markers in both that span a triangle.
    """
    measured, nominal = np.asarray(measured, float), np.asarray(nominal, float)
    if measured.shape != nominal.shape or measured.ndim != 2 or measured.shape[1] != 3:
        raise ValueError(
            "registration needs as many measured as nominal markers, shape "
            f"(n, 3) each [m], got {measured.shape} and {nominal.shape}."
        )
    if len(measured) < 3 or not np.all(np.isfinite([measured, nominal])):
        raise ValueError(
            f"registration needs at least 3 markers, got {len(measured)}; their "
            "positions must be finite."
        )
    centre_m, centre_n = measured.mean(axis=0), nominal.mean(axis=0)
    for kind, points in (("measured", measured), ("nominal", nominal)):
        _check_spread(kind, points)
    turn, *_ = Rotation.align_vectors(nominal - centre_n, measured - centre_m)
    R = turn.as_matrix()
    t = centre_n - R @ centre_m
    return Registration(R, t, measured @ R.T + t - nominal)


def _check_spread(kind: str, points: Float[HostArray, "n 3"]) -> None:
    """Raise unless the points span a triangle."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    # Far from the origin, rounding spreads even points that coincide.
    if spread[1] <= max(1e-6 * spread[0], 1e-12 * np.abs(points).max()):
        raise ValueError(
            f"the {kind} markers of the registration lie on a line, which leaves a "
            "rotation free: choose at least three that span a triangle, and check "
            "their positions."
        )


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
    """

    names: tuple[str, ...]
    positions: Float[HostArray, "n_markers 3"]
    places: tuple[str, ...]
    source: str
    covariances: Float[HostArray, "n_markers 3 3"] | None = None
    window: tuple[float, float] | None = None

    def positions_of(self, names: Sequence[str]) -> Float[HostArray, "n_wanted 3"]:
        """Return positions of some markers, in the order of their names [m].

        Raises:
            ValueError: If a marker is not there, or its position is not finite.
        """
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
