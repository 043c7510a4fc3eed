"""Which tet is at the centre of each voxel of a box."""

from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.mesh._inverse_map import barycentric_in_tets, bounds
from softcal_jax.mesh._tet_mesh import TetMesh

_INSIDE = 1e-9
"""How far a centre on a shared face may be outside both tets by rounding [-]."""

_AT_ONCE = 200_000
"""Pairs of tet and voxel that are looked at together, in some 50 MB."""


class Grid(NamedTuple):
    """Equal voxels that fill a box; their centres are at (i + 0.5) / n of its edges.

    Attributes:
        lower: Corner of the box [m].
        upper: The opposite corner [m].
        n: Number of voxels along each axis.
    """

    lower: Float[HostArray, "3"]
    upper: Float[HostArray, "3"]
    n: int

    @classmethod
    def around(cls, points: Float[HostArray, "n 3"], n: int) -> "Grid":
        """Fill the box around some points [m]."""
        return cls(points.min(axis=0), points.max(axis=0), n)

    @property
    def size(self) -> Float[HostArray, "3"]:
        """Edges of a voxel [m]."""
        return (self.upper - self.lower) / self.n

    def centres(self, voxels: Int[HostArray, "m 3"]) -> Float[HostArray, "m 3"]:
        """Return the centres of voxels by their indices [m]."""
        return self.lower + (voxels + 0.5) * self.size

    def voxels_at(self, points: Float[HostArray, "m 3"]) -> Int[HostArray, "m 3"]:
        """Return the indices of the voxels that hold some points of the box [m]."""
        found = np.floor((points - self.lower) / self.size).astype(int)
        return np.clip(found, 0, self.n - 1)


def tets_of_voxels(mesh: TetMesh, grid: Grid) -> Int[HostArray, "n n n"]:
    """Find the tet that holds the centre of each voxel; -1 where there is none."""
    X = mesh.points[mesh.tets]
    lower, upper = bounds(X)
    coordinates = _affine(X) if mesh.order == 1 else _curved(X)
    slack = _INSIDE * mesh.size
    nearest = lambda x: (x - grid.lower) / grid.size - 0.5
    first = np.maximum(np.ceil(nearest(lower - slack)), 0).astype(int)
    last = np.minimum(np.floor(nearest(upper + slack)), grid.n - 1).astype(int)
    counts = np.maximum(last - first + 1, 0)
    pairs = counts.prod(axis=1)
    owner = np.full((grid.n,) * 3, -1)
    ends = np.cumsum(pairs)
    begin = 0
    while begin < len(X):
        done = ends[begin - 1] if begin else 0
        stop = max(begin + 1, int(np.searchsorted(ends, done + _AT_ONCE, "right")))
        tets = np.repeat(np.arange(begin, stop), pairs[begin:stop])
        # The how-manieth pair of its tet each one is, then by axis.
        within = np.arange(len(tets)) - np.repeat(
            ends[begin:stop] - pairs[begin:stop] - done, pairs[begin:stop]
        )
        rest, k = np.divmod(within, counts[tets, 2])
        i, j = np.divmod(rest, counts[tets, 1])
        voxels = first[tets] + np.stack([i, j, k], axis=1)
        b = coordinates(tets, grid.centres(voxels))
        inside = np.nan_to_num(b.min(axis=1), nan=-np.inf) >= -_INSIDE
        owner[tuple(voxels[inside].T)] = tets[inside]
        begin = stop
    return owner


def _affine(X: Float[HostArray, "n_tets 4 3"]):
    """Return barycentric coordinates in linear tets as a function of tet and point."""
    inverse = np.linalg.inv(np.swapaxes(X[:, 1:] - X[:, :1], 1, 2))

    def coordinates(tets, points):
        xi = np.einsum("nij,nj->ni", inverse[tets], points - X[tets, 0])
        return np.concatenate([1.0 - xi.sum(axis=1, keepdims=True), xi], axis=1)

    return coordinates


def _curved(X: Float[HostArray, "n_tets n_en 3"]):
    """Return the same for tets that may have curved sides."""
    return lambda tets, points: barycentric_in_tets(X[tets], points)
