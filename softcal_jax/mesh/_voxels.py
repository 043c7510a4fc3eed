"""Which voxels of a box a mesh fills, and by which tets."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from softcal_jax._module import one_line
from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.elements import shape_functions
from softcal_jax.mesh._inverse_map import barycentric_in_tets, bounds
from softcal_jax.mesh._tet_mesh import TetMesh

_INSIDE = 1e-9
"""How far a centre on a shared face may be outside both tets by rounding [-]."""

_AT_ONCE = 200_000
"""Pairs of tet and voxel, or point, that are looked at together, in some 50 MB."""


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

    __repr__ = one_line

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


class Filling(NamedTuple):
    """The voxels that a mesh fills, wholly or in part.

    Attributes:
        voxels: Their indices.
        tets: A tet in each.
        places: A point of it: the centre of the voxel, if that lies in the mesh [m].
        inside: Whether it does.
    """

    voxels: Int[HostArray, "m 3"]
    tets: Int[HostArray, " m"]
    places: Float[HostArray, "m 3"]
    inside: Bool[HostArray, " m"]

    __repr__ = one_line


def fill(mesh: TetMesh, grid: Grid) -> Filling:
    """Find the voxels that a mesh fills.

    Those whose centre lies in a tet, and those in which points of a tet lie, at a
    distance below that of the voxels: a wall may be thinner.
    """
    X = mesh.points[mesh.tets]
    owner = _at_centres(mesh, X, grid)
    inside = owner >= 0
    places = np.zeros((*owner.shape, 3))
    places[inside] = grid.centres(np.argwhere(inside))
    for tets, points in _points_in_tets(X, grid):
        voxels = tuple(grid.voxels_at(points).T)
        free = owner[voxels] < 0
        voxels = tuple(axis[free] for axis in voxels)
        # Of several points in a voxel the last is kept, of both.
        places[voxels] = points[free]
        owner[voxels] = tets[free]
    found = owner >= 0
    return Filling(np.argwhere(found), owner[found], places[found], inside[found])


def _points_in_tets(
    X: Float[HostArray, "n_tets n_en 3"], grid: Grid
) -> Iterator[tuple[Int[HostArray, " m"], Float[HostArray, "m 3"]]]:
    """Yield tets and points in them, so many that they miss hardly any voxel."""
    lower, upper = bounds(X)
    parts = np.ceil(((upper - lower) / grid.size).max(axis=1)).astype(int)
    for n in np.unique(parts):
        b = _lattice(int(n))
        N = shape_functions(b, X.shape[1])
        own = np.flatnonzero(parts == n)
        for some in np.array_split(own, -(-len(own) * len(b) // _AT_ONCE)):
            points = np.einsum("pa,tai->tpi", N, X[some])
            yield np.repeat(some, len(b)), points.reshape(-1, 3)


def _lattice(n: int) -> Float[HostArray, "m 4"]:
    """Return barycentric coordinates of points in a tet, 1 / (n + 1) apart."""
    i, j, k = np.indices((n + 1,) * 3).reshape(3, -1)
    i, j, k = (axis[i + j + k <= n] for axis in (i, j, k))
    return (np.stack([n - i - j - k, i, j, k], axis=1) + 0.25) / (n + 1)


def _at_centres(
    mesh: TetMesh, X: Float[HostArray, "n_tets n_en 3"], grid: Grid
) -> Int[HostArray, "n n n"]:
    """Find the tet that holds the centre of each voxel; -1 where there is none."""
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
