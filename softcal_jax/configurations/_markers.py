"""Markers: points of the body whose positions are measured, and what carries them."""

from collections.abc import Iterable

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._module import Module, key
from softcal_jax._text import check_unique, parse_axes
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable
from softcal_jax.bodies import as_floats, three_numbers
from softcal_jax.configurations._effector import EffectorRecord, EffectorRow, Unstated
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
