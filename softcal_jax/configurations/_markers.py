"""Markers: points whose positions are measured, tables of these, and registration."""

import os
import warnings
from collections.abc import Iterable, Mapping, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike
from scipy.spatial.transform import Rotation

from softcal_jax._module import Module, key
from softcal_jax._text import check_unique, parse_axes, suggestion
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable
from softcal_jax.bodies import as_floats, three_numbers
from softcal_jax.configurations._csv_table import coordinates, read_table
from softcal_jax.configurations._effector import EffectorRecord, EffectorRow, Unstated
from softcal_jax.configurations._tracker import TrackerWarning
from softcal_jax.mesh import TetMesh, locate, volumes

_LENGTH = key("m", size="not negative")

STD = Unstated(1e-3)
"""Standard deviation of the measurement where none is stated [m]."""


def _as_names(names: str | Iterable[str]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


class Markers(Module):
    """Material points of the body, on it or on posts that stand slightly outside.

    Attributes:
        names: One name per marker; a single one may be given by itself.
        positions: Positions at rest, in the frame of the mesh [m].
        std: Standard deviation of the measurement: one for all, one per marker, or one
            per marker and axis; the default of 1 mm only weighs them [m].
        axes: Axes that are measured, like "xyz" or "xz".
        max_distance: How far from the mesh a marker may stand [m].
        base_radius: For markers on posts: the post follows the affine motion fitted to
            the nodes within this radius of its foot. 0 uses only the tet at the marker,
            whose local strain a post would magnify. Stay below the straight distance to
            another part of the body, like the far side of a slit [m].
    """

    names: tuple[str, ...] = eqx.field(converter=_as_names)
    positions: Float[HostArray, "n_markers 3"] = eqx.field(converter=as_floats)
    std: Float[ArrayLike, "..."] = STD
    axes: str = "xyz"
    max_distance: float = eqx.field(default=0.01, metadata=_LENGTH)
    base_radius: float = eqx.field(default=0.0, metadata=_LENGTH)

    def __check_init__(self):
        parse_axes(self.axes)
        for name in ("max_distance", "base_radius"):
            if not 0.0 <= (value := getattr(self, name)) < np.inf:
                raise ValueError(f"{name} must be finite, 0 or more; got {value:g}.")
        n, shape = len(self.names), self.positions.shape
        if shape != (n, 3):
            raise ValueError(f"positions need the shape ({n}, 3) [m], got {shape}.")
        for name, position in zip(self.names, self.positions, strict=True):
            three_numbers(f"the position of marker {name!r}", "m", position)
        check_unique("marker", self.names)
        std = np.asarray(self.std, float)
        fits = std.shape in ((), (n,), (n, 3))
        bad = std[~(np.isfinite(std) & (std > 0))]
        if not fits or bad.size:
            got = f"{bad[0]:g}" if fits else f"shape {std.shape}"
            raise ValueError(
                "std must be positive and finite [m], one number, one per marker "
                f"({n},) or one per marker and axis ({n}, 3), got {got}; a coordinate "
                "without precision is left out with `axes`."
            )

    def stds(self) -> Float[HostArray, "n_markers 3"]:
        """Return standard deviations, infinite on axes that are not measured [m]."""
        std = np.asarray(self.std, float)
        std = std[:, None] if std.ndim == 1 else std
        counts = np.isin(range(3), parse_axes(self.axes))
        return np.where(counts, std, np.full((len(self.names), 3), np.inf))

    def check_measured(self, measured: Float[HostArray, "n 3"], owner: str) -> None:
        """Raise ValueError unless each marker has a finite position on its axes."""
        if measured.shape != self.positions.shape:
            raise ValueError(
                f"configuration {owner!r} has {len(self.names)} markers "
                f"({', '.join(self.names)}), so `measured` needs the shape "
                f"{self.positions.shape}, got {measured.shape}."
            )
        used = measured[:, parse_axes(self.axes)]
        bad = np.flatnonzero(~np.isfinite(used).all(axis=1))
        if bad.size:
            raise ValueError(
                f"marker {self.names[bad[0]]!r} of configuration {owner!r} was "
                f"measured at {measured[bad[0]]}: expected finite numbers [m]. Leave a "
                "marker that was lost out of this configuration's markers."
            )

    def rows(
        self, mesh: TetMesh, measured: Float[HostArray, "n_markers 3"] | None
    ) -> list[EffectorRow]:
        """Return them as rows of effectors, with their measured values if given."""
        values, stds = measured, self.stds()
        if values is None:
            values, stds = np.full_like(stds, np.nan), np.full_like(stds, np.inf)
        of_each = self.names, values, stds, _carriers(mesh, self)
        return [
            EffectorRow(EffectorRecord.of(name, "point", "m", value, std), *carriers)
            for name, value, std, carriers in zip(*of_each, strict=True)
        ]


def _carriers(
    mesh: TetMesh, markers: Markers
) -> list[tuple[HostArray, HostArray, HostArray]]:
    """Find nodes, weights and slopes of the `EffectorRow` of each marker."""
    places = locate(
        mesh,
        markers.positions,
        max_distance=markers.max_distance,
        names=[f"marker {name!r}" for name in markers.names],
    )
    if markers.base_radius == 0.0:
        return list(zip(places.nodes, places.weights, places.slopes, strict=True))
    # The volume of each tet is shared evenly among its nodes: integrals of quadratic
    # shape functions would give corners a negative share.
    volume = np.zeros(mesh.n_nodes)
    np.add.at(volume, mesh.tets, volumes(mesh)[:, None] / mesh.tets.shape[1])
    feet = zip(places.foot, markers.positions, markers.names, strict=True)
    return [_patch(mesh, volume, *foot, radius=markers.base_radius) for foot in feet]


def _patch(mesh, volume, foot, position, name, *, radius):
    """Return nodes within a radius of the foot, which carry by their affine motion."""
    nodes = np.flatnonzero(np.linalg.norm(mesh.points - foot, axis=1) <= radius)
    share = np.sqrt(volume[nodes])
    centre = mesh.points[nodes].mean(axis=0) if nodes.size else foot
    # Affine functions at the nodes, in units of the radius for good conditioning.
    A = np.column_stack([np.ones(nodes.size), (mesh.points[nodes] - centre) / radius])
    singular = np.linalg.svd(share[:, None] * A, compute_uv=False)
    if nodes.size < 4 or singular[-1] < 1e-3 * singular[0]:
        raise ValueError(
            f"marker {name!r}: only {nodes.size} nodes lie within base_radius "
            f"{readable(radius, 'm')} of its foot, too few to carry a post. Refine the "
            "mesh there, or raise base_radius above the edge length."
        )
    fit = np.linalg.pinv(share[:, None] * A) * share
    weights = fit[0] + (position - centre) / radius @ fit[1:]
    return nodes, weights, fit[1:].T / radius


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

    def apply(self, points: Float[ArrayLike, "n 3"]) -> Float[HostArray, "n 3"]:
        """Move points from the camera frame to the mesh frame [m]."""
        return np.asarray(points, float) @ self.rotation.T + self.translation


def register(
    measured: Float[ArrayLike, "n_markers 3"],
    nominal: Float[ArrayLike, "n_markers 3"],
    *,
    rotation: Float[ArrayLike, "3 3"] | None = None,
) -> Registration:
    """Fit the rigid motion that takes measured markers onto nominal positions.

    The least-squares rotation of Kabsch (Acta Cryst. A32, 1976), by
    `scipy.spatial.transform.Rotation.align_vectors`. Positions are `measured` in the
    camera frame and `nominal` in the mesh frame [m]. With a known `rotation`, camera
    axes to mesh axes, one marker is enough [-].

    Raises:
        ValueError: If there are not three finite markers in both that span a triangle,
            or not one where the rotation is known.
    """
    measured, nominal = np.asarray(measured, float), np.asarray(nominal, float)
    if measured.shape != nominal.shape or measured.ndim != 2 or measured.shape[1] != 3:
        raise ValueError(
            "registration needs as many measured as nominal markers, shape "
            f"(n, 3) each [m], got {measured.shape} and {nominal.shape}."
        )
    least = 3 if rotation is None else 1
    if len(measured) < least or not np.all(np.isfinite([measured, nominal])):
        raise ValueError(
            f"registration needs at least {least} finite markers, got {len(measured)}."
        )
    R = _rotation_onto(measured, nominal) if rotation is None else np.asarray(rotation)
    t = nominal.mean(axis=0) - R @ measured.mean(axis=0)
    return Registration(R, t, measured @ R.T + t - nominal)


def _rotation_onto(measured, nominal) -> Float[HostArray, "3 3"]:
    """Fit the rotation; the markers must span a triangle."""
    for kind, points in (("measured", measured), ("nominal", nominal)):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        # Far from the origin, rounding spreads even points that coincide.
        if spread[1] <= max(1e-6 * spread[0], 1e-12 * np.abs(points).max()):
            raise ValueError(
                f"the {kind} markers of the registration lie on a line, which leaves a "
                "rotation free: choose at least three that span a triangle."
            )
    about = [points - points.mean(axis=0) for points in (nominal, measured)]
    turn, *_ = Rotation.align_vectors(*about)
    return turn.as_matrix()


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
