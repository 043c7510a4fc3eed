"""Meshes of boxes, and which voxels of a box a mesh fills."""

import math
from collections.abc import Iterator
from itertools import permutations, product
from typing import Any, NamedTuple

import numpy as np

from softcal_jax._places import TETS
from softcal_jax._text import check_known
from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.elements import shape_functions
from softcal_jax.mesh._location import barycentric_in_tets, bounds, tets_at
from softcal_jax.mesh._tet_mesh import ArrayData, TetMesh, check_order, to_quadratic
from softcal_jax.mesh._topology import boundary_faces, corner_volumes


def oriented(tets: HostArray, corners: HostArray) -> HostArray:
    """Swap the last two nodes of linear tets whose corners give a negative volume."""
    tets, inverted = tets.copy(), corner_volumes(corners) < 0
    tets[inverted] = tets[inverted][:, [0, 1, 3, 2]]
    return tets


def _kuhn_cell(parity: tuple[int, ...]) -> HostArray:
    """Cut a cell into six tets, the paths from its even to its odd corner (Kuhn, 1960).

    Corners are indices of the lattice with half the step of the cells.
    """
    unit = np.eye(3, dtype=int)
    paths = np.array(
        [
            np.cumsum([np.zeros(3, int), *unit[list(order)]], axis=0)
            for order in permutations(range(3))
        ]
    )
    flip = np.array(parity)
    corners = 2 * (flip + (1 - 2 * flip) * paths)
    return oriented(corners, corners)


_KUHN_CELLS = np.array([_kuhn_cell(parity) for parity in product((0, 1), repeat=3)])


def kuhn_tets(cells: HostArray) -> HostArray:
    """Choose the cut of each cell by its indices, mirrored from cell to cell."""
    return _KUHN_CELLS[cells % 2 @ np.array([4, 2, 1])]


def _centred_cell() -> HostArray:
    """Cut a cell into 24 tets: its centre, a face centre and an edge of the face."""
    tets = []
    for axis, side in product(range(3), (0, 2)):
        face = np.ones(3, int)
        face[axis] = side
        ring = np.full((4, 3), side)
        ring[:, (axis + 1) % 3] = [0, 2, 2, 0]
        ring[:, (axis + 2) % 3] = [0, 0, 2, 2]
        tets += [[np.ones(3, int), face, ring[k], ring[(k + 1) % 4]] for k in range(4)]
    corners = np.array(tets)
    return oriented(corners, corners)


def beam(
    length: float,
    width: float,
    height: float,
    cells: ArrayData,
    *,
    origin: ArrayData = (0.0, 0.0, 0.0),
    order: int = 1,
    pattern: str = "mirrored",
) -> TetMesh:
    """Mesh a box with tets, without diagonal bias.

    "mirrored" cuts each cell into Kuhn's six tets and mirrors the cut from cell to
    cell, so linear tets have (nx+1)(ny+1)(nz+1) nodes. The mesh is symmetric about a
    mid-plane if the cell count across it is even. If it is odd, a beam under its own
    weight drifts sideways, most with a single linear cell across.
    "centred" adds a node in each cell and face and cuts the cell into 24 tets:
    symmetric for every count.

    The node and surface groups "x_min", "x_max", ..., "z_max" are the six sides.

    Args:
        length: Extent along x [m].
        width: Extent along y [m].
        height: Extent along z [m].
        cells: Number of cells along x, y and z.
        origin: Corner with the smallest coordinates [m].
        order: 1 for linear tets, 2 for quadratic ones.
        pattern: How a cell is cut into tets: "mirrored" or "centred".

    Raises:
        ValueError: If an extent or a cell count is not positive, there are too many
            cells, or the order or pattern is unknown.
    """
    extent = np.array([length, width, height], dtype=float)
    if not (np.isfinite(extent).all() and (extent > 0).all()):
        raise ValueError(
            f"length, width and height must be positive [m], got {extent.tolist()}."
        )
    counts = np.asarray(cells)
    if counts.shape != (3,) or counts.dtype.kind not in "iu" or counts.min() < 1:
        raise ValueError(f"cells must be three positive integers, got {cells}.")
    lower = np.asarray(origin, dtype=float)
    if lower.shape != (3,) or not np.isfinite(lower).all():
        raise ValueError(f"origin must be three finite numbers [m], got {origin}.")
    check_order(order)
    check_known("pattern", ("mirrored", "centred"), pattern)
    centred = _centred_cell() if pattern == "centred" else None
    each = len(_KUHN_CELLS[0] if centred is None else centred)
    TETS.check(f"cells = {counts.tolist()}", each * math.prod(counts.tolist()))

    # Tets of nodes of the lattice with half the step of the cells.
    grid = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1)
    grid = grid.reshape(-1, 3)
    nodes = 2 * grid[:, None, None] + (kuhn_tets(grid) if centred is None else centred)
    lattice = tuple(2 * counts + 1)
    numbers = np.ravel_multi_index(tuple(np.moveaxis(nodes, -1, 0)), lattice)
    used, tets = np.unique(numbers, return_inverse=True)
    upper = lower + extent
    axes = [
        np.linspace(a, b, 2 * n + 1)
        for a, b, n in zip(lower, upper, counts, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)[used]
    mesh = _with_sides(TetMesh(points, tets.reshape(-1, 4)), lower, upper)
    return mesh if order == 1 else to_quadratic(mesh)


def _with_sides(mesh: TetMesh, lower: HostArray, upper: HostArray) -> TetMesh:
    """Add the sides of the box as groups; `linspace` ends exactly on them."""
    faces = boundary_faces(mesh)
    nodes, surfaces = {}, {}
    for axis, letter in enumerate("xyz"):
        for side, value in (("min", lower[axis]), ("max", upper[axis])):
            on_side = mesh.points[:, axis] == value
            nodes[f"{letter}_{side}"] = np.flatnonzero(on_side)
            surfaces[f"{letter}_{side}"] = faces[on_side[faces].all(axis=1)]
    return TetMesh(mesh.points, mesh.tets, nodes, surfaces)


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
