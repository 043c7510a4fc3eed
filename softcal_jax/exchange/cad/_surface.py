"""Surfaces of triangles: reading them, and turning their triangles outwards."""

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.mesh import seen_from, sides_of

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
"""A triangle of a binary STL file."""


_FAR = 1e7
"""Distance from the origin where single precision holds no shape, over the size [-]."""

_THIN = 1e-6
"""Height of a triangle without an area, over the size of the surface [-]."""

_TANGLED = 0.25
"""Share of triangles that run through others, above which a part is no surface [-]."""

_TRIED = 200  # triangles for which that is found out


class Triangles(NamedTuple):
    """A surface of triangles in the unit of its file, with each corner once."""

    points: Float[HostArray, "n_points 3"]
    triangles: Int[HostArray, "n_triangles 3"]

    @property
    def corners(self) -> Float[HostArray, "n_triangles 3 3"]:
        return self.points[self.triangles]

    @property
    def volume(self) -> float:
        """Volume that the triangles enclose, where their normals point outwards."""
        return float(np.sum(_cones(self.corners)))

    @property
    def areas(self) -> Float[HostArray, " n_triangles"]:
        a, b, c = np.moveaxis(self.corners, 1, 0)
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)

    @property
    def given(self) -> dict[str, Any]:
        """What the program that fills it needs."""
        size = {"volume": abs(self.volume), "area": self.areas.sum()}
        return self._asdict() | size

    @property
    def polydata(self) -> Any:
        """The surface for PyVista, whose triangles keep their order."""
        # Imported here, so that other commands do not wait for it.
        import pyvista

        return pyvista.PolyData.from_regular_faces(self.points, self.triangles)


def read_stl(path: Path) -> Triangles:
    """Read an STL file, binary or text; corners at the same place become one.

    Raises:
        ValueError: If it cannot be read, or holds no triangles.
    """
    content = path.read_bytes()
    n = int.from_bytes(content[80:84], "little")
    # Text has letters there, which would be more triangles than the file has room for.
    # What stands behind as many as are stated was appended by some program.
    if 0 < 50 * n <= len(content) - 84:
        values = np.frombuffer(content, _FACET, n, offset=84)["corners"].reshape(-1, 3)
    else:
        words = re.findall(rb"(?i)\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", content)
        n = len(re.findall(rb"(?i)\bfacet\s+normal\b", content))
        try:
            values = np.array(words).astype(float)
        except ValueError as error:
            raise ValueError(f"it cannot be read as STL: {error}.") from error
    if not n or len(values) != 3 * n or not np.isfinite(values).all():
        raise ValueError(
            f"it holds {n} triangles with {len(values)} corners, expected a closed "
            "surface of triangles with finite coordinates."
        )
    points, corners = np.unique(values.astype(float), axis=0, return_inverse=True)
    surface = Triangles(points, corners.reshape(-1, 3))
    _check_shape(surface)
    return surface


def _check_shape(surface: Triangles) -> None:
    """Raise for what no program fills, since some of them try for ever."""
    size = np.linalg.norm(np.ptp(surface.points, axis=0))
    far = np.abs(surface.points).max() / max(size, np.finfo(float).tiny)
    a, b, c = np.moveaxis(surface.corners, 1, 0)
    longest = np.linalg.norm([b - a, c - b, a - c], axis=-1).max(axis=0)
    thin = np.mean(2.0 * surface.areas <= _THIN * size * longest)
    loose = np.mean(sides_of(surface.triangles).counts == 1)
    for bad, what in (
        (far > _FAR, f"it lies {far:.2g} times its size away from the origin"),
        (
            thin > 0.1,
            f"{thin:.0%} of its triangles are thinner than {_THIN * size:.2g}",
        ),
        (loose > 0.5, f"{loose:.0%} of its edges belong to one triangle alone"),
    ):
        if bad:
            raise ValueError(
                f"{what}; expected the surface of a body. Export it again."
            )


def turned_outwards(surface: Triangles) -> tuple[Triangles, list[str]]:
    """Turn the triangles of each closed part outwards, or inwards as a cavity's wall.

    A part within another is the wall of a cavity, one within that a body again. Parts
    with open edges are turned as most of their area is. Also returns what to say of it.

    Raises:
        ValueError: If neighbours cannot be turned alike, as on a Moebius strip, or a
            part runs through itself nearly everywhere.
    """
    part, flip = _alike(surface.triangles)
    _check_tangle(surface, part)
    triangles = surface.triangles.copy()
    triangles[flip] = triangles[flip, ::-1]
    corners, in_file = surface.points[triangles], np.where(flip, -1.0, 1.0)
    sign = lambda values: np.where(np.bincount(part, values) < 0.0, -1.0, 1.0)
    kept = sign(in_file * surface.areas)
    sides = sides_of(triangles)
    is_open = np.zeros(part.max() + 1, bool)
    is_open[part[np.flatnonzero(sides.counts[sides.edge] != 2) // 3]] = True
    inside = _nested(surface._replace(triangles=triangles), part, ~is_open)
    depth = inside.sum(axis=1)
    outer = np.where(is_open, kept, sign(_cones(corners)) * (-1.0) ** depth)
    inwards = outer[part] < 0.0
    triangles[inwards] = triangles[inwards, ::-1]
    turned = in_file * outer[part] < 0.0
    # The wall of a cavity is turned against what surrounds it, in a sound file.
    wrong = kept * outer
    around = inside & (depth[None] == depth[:, None] - 1)
    alike = np.any(around & (wrong[:, None] != wrong[None]), axis=1) & (depth % 2 == 1)
    notes = []
    if n_turned := int(np.sum(turned & ~alike[part])):
        notes.append(
            f"{n_turned} of {len(triangles)} triangles are turned the wrong way in the "
            "file; they were turned over."
        )
    for k in np.flatnonzero(alike):
        middle = corners[part == k].mean(axis=(0, 1))
        notes.append(
            f"the closed surface around ({', '.join(f'{x:.4g}' for x in middle)}), in "
            "the unit of the file, lies within another one and is turned as that is. It"
            " is taken for the wall of a cavity: if it is one, turn its triangles; if "
            "the body is solid there, delete it."
        )
    return surface._replace(triangles=triangles), notes


def _check_tangle(surface: Triangles, part: Int[HostArray, " n"]) -> None:
    """Raise for a part that runs through itself nearly everywhere: noise, no body.

    Some programs would try to fill it for hours.
    """
    body, corners = surface.polydata, surface.corners
    middle = corners.mean(axis=1, keepdims=True)
    inside = middle + 0.99 * (corners - middle)  # so that no neighbour is met
    tried = np.random.default_rng(0).permutation(len(part))[:_TRIED]
    met = lambda k, end: body.ray_trace(middle[k, 0], end)[1]
    through = [
        any((part[m] == part[k]) & (m != k) for end in inside[k] for m in met(k, end))
        for k in tried
    ]
    if (share := np.mean(through)) > _TANGLED:
        raise ValueError(
            f"about {share:.0%} of its triangles run through others of the same part; "
            "expected the surface of a body. Export it again."
        )


def _alike(
    triangles: Int[HostArray, "n 3"],
) -> tuple[Int[HostArray, " n"], Bool[HostArray, " n"]]:
    """Number the connected parts, and find whom to flip so that neighbours are alike.

    Triangle i stands twice, as it is (i) and flipped (n + i); what is joined to one of
    them is to be turned alike.
    """
    n, sides = len(triangles), sides_of(triangles)
    left, right = (sides.pairs // 3).T
    # Neighbours that are turned alike go along their edge in opposite directions.
    first, second = sides.forwards[sides.pairs].T
    other = n * (first == second)
    rows = np.concatenate([left, n + left])
    columns = np.concatenate([right + other, right + n - other])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), (2 * n, 2 * n))
    as_is, flipped = connected_components(graph, directed=False)[1].reshape(2, n)
    if np.any(as_is == flipped):
        raise ValueError(
            "its triangles have no inside and outside: from one to the next, they turn "
            "over, as on a Moebius strip. Mend the surface, or export a STEP file."
        )
    _, part = np.unique(np.minimum(as_is, flipped), return_inverse=True)
    return part.ravel(), as_is > flipped


def _cones(corners: Float[HostArray, "n 3 3"]) -> Float[HostArray, " n"]:
    """Compute the volumes of the tets from one place to triangles, with their sign."""
    a, b, c = np.moveaxis(corners - corners[0, 0], 1, 0)
    return np.sum(a * np.cross(b, c), axis=1) / 6.0


def _nested(
    surface: Triangles, part: Int[HostArray, " n"], closed: Bool[HostArray, " n_parts"]
) -> Bool[HostArray, "n_parts n_parts"]:
    """Tell which closed part lies inside which other one, without crossing it."""
    inside = np.zeros((len(closed), len(closed)), bool)
    parts = [
        surface._replace(triangles=surface.triangles[part == k])
        for k in range(len(closed))
    ]
    low, high = (
        np.array([f(one.corners, axis=(0, 1)) for one in parts])
        for f in (np.min, np.max)
    )
    for k in np.flatnonzero(closed):
        maybe = closed & np.all((low <= low[k]) & (high >= high[k]), axis=1)
        maybe[k] = False
        for other in np.flatnonzero(maybe):
            point = parts[k].corners[0].mean(axis=0)
            if abs(seen_from(parts[other].corners, point).sum()) > 0.5:
                of_others = parts[other].polydata
                meet = parts[k].polydata.collision(of_others, contact_mode=1)[1]
                inside[k, other] = not meet
    return inside
