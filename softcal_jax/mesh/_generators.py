"""Meshes of boxes."""

import math
from itertools import permutations, product

import numpy as np

from softcal_jax._limits import TETS
from softcal_jax._names import check_known
from softcal_jax._typing import HostArray
from softcal_jax.mesh._tet_mesh import ArrayData, TetMesh, check_order, to_quadratic
from softcal_jax.mesh._topology import boundary_faces


def oriented(tets: HostArray, corners: HostArray) -> HostArray:
    """Swap the last two nodes of linear tets whose corners give a negative volume."""
    inverted = np.linalg.det((corners[:, 1:] - corners[:, :1]).astype(float)) < 0
    tets = tets.copy()
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
