"""Triangles of an STL file."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.mesh import ParserError, parse_mesh_file


class Triangles(NamedTuple):
    """A surface of triangles in the unit of its file, with each corner once."""

    points: Float[HostArray, "n_points 3"]
    triangles: Int[HostArray, "n_triangles 3"]

    @property
    def volume(self) -> float:
        """Volume that the triangles enclose, where their normals point outwards."""
        a, b, c = np.moveaxis(self.points[self.triangles] - self.points[0], 1, 0)
        return float(np.sum(a * np.cross(b, c)) / 6.0)

    @property
    def n_open_edges(self) -> int:
        """Number of edges that do not belong to exactly two triangles."""
        ends = np.stack([self.triangles, np.roll(self.triangles, -1, axis=1)], axis=-1)
        ends = np.sort(ends.reshape(-1, 2), axis=1)
        _, counts = np.unique(ends, axis=0, return_counts=True)
        return int(np.sum(counts != 2))


def read_stl(path: Path) -> Triangles:
    """Read an STL file, binary or text; corners at the same place become one.

    Raises:
        ValueError: If it cannot be read, or holds no triangles.
    """
    try:
        raw, _ = parse_mesh_file(path, "stl")
    except ParserError as error:
        raise ValueError(
            "it cannot be read as STL; it may be truncated or another kind of file. The"
            f" parser said: {error}"
        ) from error
    triangles = raw.cells_dict.get("triangle", np.zeros((0, 3), int))
    points = np.asarray(raw.points, float)
    if not len(triangles) or not np.isfinite(points).all():
        raise ValueError(
            f"it holds {len(triangles)} triangles, expected a closed surface of "
            "triangles with finite coordinates."
        )
    return Triangles(points, np.asarray(triangles, int))
