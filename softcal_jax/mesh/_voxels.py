"""Which voxels of a box a mesh fills, and by which tets."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.elements import shape_functions
from softcal_jax.mesh._location import barycentric_in_tets, bounds, tets_at
from softcal_jax.mesh._tet_mesh import TetMesh

_AT_ONCE = 200_000  # points in tets that are processed together, in some 50 MB


class Grid(NamedTuple):
    """Equal voxels that fill a box, n along each axis, between two corners [m]."""

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
        voxels = np.floor((points - self.lower) / self.size).astype(int)
        return np.clip(voxels, 0, self.n - 1)


class Filling(NamedTuple):
    """The voxels that a mesh fills, wholly or in part.

    Attributes:
        voxels: Their indices.
        tets: A tet that reaches into each of these voxels.
        places: A point of this tet in the voxel: the centre of the voxel, if that lies
            in the mesh [m].
        inside: Whether the centre of the voxel lies in the mesh.
    """

    voxels: Int[HostArray, "m 3"]
    tets: Int[HostArray, " m"]
    places: Float[HostArray, "m 3"]
    inside: Bool[HostArray, " m"]


def fill(mesh: TetMesh, grid: Grid) -> Filling:
    """Find the voxels that a mesh fills.

    A voxel is filled if its centre lies in a tet. As a wall may be thinner than a
    voxel, it is also filled if one of many points spread over each tet lies in it.
    These points are closer to each other than the voxels.
    """
    owner = _at_centres(mesh, grid)
    inside = owner >= 0
    places = np.zeros((*owner.shape, 3))
    places[inside] = grid.centres(np.argwhere(inside))
    for tets, points in _points_in_tets(mesh, grid):
        voxels = tuple(grid.voxels_at(points).T)
        free = owner[voxels] < 0
        voxels = tuple(axis[free] for axis in voxels)
        # Of several points in a voxel the last one counts, in both arrays.
        places[voxels] = points[free]
        owner[voxels] = tets[free]
    filled = owner >= 0
    return Filling(np.argwhere(filled), owner[filled], places[filled], inside[filled])


def _points_in_tets(
    mesh: TetMesh, grid: Grid
) -> Iterator[tuple[Int[HostArray, " m"], Float[HostArray, "m 3"]]]:
    """Yield tets and points in them, dense enough to miss hardly any voxel."""
    X = mesh.points[mesh.tets]
    lower, upper = bounds(X)
    parts = np.ceil(((upper - lower) / grid.size).max(axis=1)).astype(int)
    for n in np.unique(parts):
        # Barycentric coordinates, 1 / (n + 1) apart.
        i, j, k = np.indices((n + 1,) * 3).reshape(3, -1)
        i, j, k = (axis[i + j + k <= n] for axis in (i, j, k))
        b = (np.stack([n - i - j - k, i, j, k], axis=1) + 0.25) / (n + 1)
        N = shape_functions(b, X.shape[1])
        alike = np.flatnonzero(parts == n)
        for some in np.array_split(alike, -(-len(alike) * len(b) // _AT_ONCE)):
            points = np.einsum("pa,tai->tpi", N, X[some])
            yield np.repeat(some, len(b)), points.reshape(-1, 3)


def _at_centres(mesh: TetMesh, grid: Grid) -> Int[HostArray, "n n n"]:
    """Find the tet that holds the centre of each voxel; -1 where there is none.

    Around a curved tet, VTK accepts centres up to a thousandth of its size outside, so
    all centres in curved tets are checked again.
    """
    # Imported here, so that other commands do not wait for it.
    import pyvista

    kind = (pyvista.CellType.TETRA, pyvista.CellType.QUADRATIC_TETRA)[mesh.order - 1]
    tets = pyvista.UnstructuredGrid({kind: mesh.tets}, mesh.points)
    tets.cell_data["tet"] = np.arange(mesh.n_tets)
    centres = pyvista.ImageData(
        dimensions=(grid.n,) * 3,
        spacing=grid.size.tolist(),
        origin=grid.centres(np.zeros((1, 3), int))[0].tolist(),
    )
    sampled: Any = centres.sample(tets)
    owner = np.where(sampled["vtkValidPointMask"], sampled["tet"], -1)
    owner = owner.astype(int).reshape((grid.n,) * 3, order="F")
    if mesh.order == 2:
        voxels = np.argwhere(owner >= 0)
        for some in np.array_split(voxels, -(-len(voxels) // _AT_ONCE) or 1):
            tets, x = owner[tuple(some.T)], grid.centres(some)
            b = barycentric_in_tets(mesh.points[mesh.tets[tets]], x)
            outside = ~(b.min(axis=1) >= 0.0)
            owner[tuple(some[outside].T)], _ = tets_at(mesh, x[outside])
    return owner
