"""Surfaces of triangles: reading them, and turning their triangles outwards."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.mesh import ParserError, parse_mesh_file, seen_from, sides_of


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


def read_stl(path: Path) -> Triangles:
    """Read an STL file, binary or text; corners at the same place become one.

    Raises:
        ValueError: If it cannot be read, or holds no triangles.
    """
    try:
        raw, _ = parse_mesh_file(path, "stl")
    except ParserError as error:
        said = f"it cannot be read as STL. The parser said: {error}"
        raise ValueError(said) from error
    triangles = raw.cells_dict.get("triangle", np.zeros((0, 3), int))
    points = np.asarray(raw.points, float)
    if not len(triangles) or not np.isfinite(points).all():
        raise ValueError(
            f"it holds {len(triangles)} triangles, expected a closed surface of "
            "triangles with finite coordinates."
        )
    return Triangles(points, np.asarray(triangles, int))


def turned_outwards(surface: Triangles) -> tuple[Triangles, list[str]]:
    """Turn the triangles of each closed part outwards, or inwards as a cavity's wall.

    A part within another is the wall of a cavity, one within that a body again. Parts
    with open edges are turned as most of their area is. Also returns what to say of it.

    Raises:
        ValueError: If neighbours cannot be turned alike, as on a Moebius strip.
    """
    part, flip = _alike(surface.triangles)
    triangles = surface.triangles.copy()
    triangles[flip] = triangles[flip, ::-1]
    corners, in_file = surface.points[triangles], np.where(flip, -1.0, 1.0)
    sign = lambda values: np.where(np.bincount(part, values) < 0.0, -1.0, 1.0)
    a, b, c = np.moveaxis(corners, 1, 0)
    kept = sign(in_file * np.linalg.norm(np.cross(b - a, c - a), axis=1))
    sides = sides_of(triangles)
    is_open = np.zeros(part.max() + 1, bool)
    is_open[part[np.flatnonzero(sides.counts[sides.edge] != 2) // 3]] = True
    inside = _nested(corners, part, ~is_open)
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
    corners: Float[HostArray, "n 3 3"],
    part: Int[HostArray, " n"],
    closed: Bool[HostArray, " n_parts"],
) -> Bool[HostArray, "n_parts n_parts"]:
    """Tell which closed part lies inside which other one, by one point of each."""
    inside = np.zeros((len(closed), len(closed)), bool)
    of_part = [corners[part == k] for k in range(len(closed))]
    low, high = (
        np.array([f(c, axis=(0, 1)) for c in of_part]) for f in (np.min, np.max)
    )
    for k in np.flatnonzero(closed):
        point = of_part[k][0].mean(axis=0)
        maybe = closed & np.all((low < point) & (point < high), axis=1)
        maybe[k] = False
        for other in np.flatnonzero(maybe):
            inside[k, other] = abs(seen_from(of_part[other], point).sum()) > 0.5
    return inside
