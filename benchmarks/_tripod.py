"""Mesh of the flat sheet with branches and a hole of the parallel robot, Sec. VI."""

import math
from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax.mesh import (
    TetMesh,
    boundary_faces,
    check_order,
    oriented,
    to_quadratic,
)
from softcal_jax.mesh._generators import kuhn_tets


class _Sector(NamedTuple):
    """The grid of one branch: rows go outwards, columns go around.

    The fan from the hole to the root of the branch uses all columns, the strip along
    the branch only the middle ones. The last column is the first of the next branch.
    """

    points: Float[HostArray, "n_rows n_columns 2"]
    used: Bool[HostArray, "n_rows-1 n_columns-1"]
    n_centre: int
    n_fan: int
    n_end: int


def tripod(
    length: float = 0.066,
    width: float = 0.030,
    thickness: float = 0.005,
    *,
    hole_radius: float = 0.005,
    centre_radius: float = 0.0075,
    end_length: float = 0.015,
    branches: int = 3,
    y: float = 0.0,
    size: float = 0.005,
    layers: int = 1,
    order: int = 2,
) -> TetMesh:
    """Mesh a flat sheet of equal branches around a hole; by default that of Sec. VI.

    The sheet lies in the (x, z) plane. Branch k, from 1, leaves at the azimuth
    360 (k - 1) / branches degrees, counted from +x towards +z. The hole is a polygon
    with its corners on the circle. The mesh has every symmetry of the plane sheet; top
    and bottom mirror each other if the number of layers is even.

    Node and tet groups: "end 1", "end 2", ... and "centre"; sides of tets lie along
    their borders. Surface groups: "top" (largest y) and "bottom".

    Lengths are in metres: `length` that of a branch from the centre of the sheet,
    `thickness` along y, `centre_radius` and `end_length` those of the groups, `y` where
    the mid-surface lies, and `size` that of edges in the plane, which the branches come
    close to. There are `layers` of tets through the thickness; linear ones (order 1)
    are far too stiff in bending.

    Raises:
        ValueError: If a number is out of its range, the centre does not fit between
            the branches, or a branch is too short for its end.
    """
    lengths = {
        "length": length,
        "width": width,
        "hole_radius": hole_radius,
        "centre_radius": centre_radius,
        "end_length": end_length,
        "size": size,
    }
    for name, value in {**lengths, "thickness": thickness}.items():
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} must be positive and finite [m], got {value}.")
    if not np.isfinite(y):
        raise ValueError(f"y must be finite [m], got {y}.")
    for name, value, least in (("branches", branches, 2), ("layers", layers, 1)):
        if value < least:
            raise ValueError(f"{name} must be {least} or more, got {value}.")
    check_order(order)
    sector = _sector(**lengths, branches=branches)
    levels = y + thickness * (np.arange(layers + 1) / layers - 0.5)
    mesh = _extruded(sector, branches, levels)
    faces = boundary_faces(mesh)
    for name, side in (("top", levels[-1]), ("bottom", levels[0])):
        on_side = (mesh.points[:, 1][faces] == side).all(axis=1)
        mesh = mesh.with_surface_group(name, faces[on_side])
    return mesh if order == 1 else to_quadratic(mesh)


def _sector(
    *,
    length: float,
    width: float,
    hole_radius: float,
    centre_radius: float,
    end_length: float,
    size: float,
    branches: int,
) -> _Sector:
    """Place the grid of the branch at azimuth zero, (x, z) [m]."""
    pitch, half = math.pi / branches, width / 2.0
    # Neighbouring branches meet in a notch; the strip along a branch begins past it.
    along = half / math.tan(pitch)
    root, reach = max(half, along + size), math.hypot(along, half)
    if not hole_radius < centre_radius < reach:
        raise ValueError(
            f"hole_radius < centre_radius < {reach:.4g} m is needed, where the sides "
            f"of neighbouring branches meet; got {hole_radius:g} and "
            f"{centre_radius:g} m."
        )
    begin = length - end_length
    if not end_length < length - root:
        raise ValueError(
            f"end_length must be below {length - root:.4g} m, what is left of the "
            f"branch past its root at {root:.4g} m; got {end_length:g} m."
        )
    # An odd number, so that no cut crosses the sharp cell at the corner of the root.
    n_side = 1 + 2 * max(0, round(((root - along) / size - 1.0) / 2.0))
    n_across = 2 * max(1, round(half / size))
    n_around = n_across + 2 * n_side

    side = np.column_stack(
        [np.linspace(along, root, n_side + 1), np.full(n_side + 1, half)]
    )
    across = np.linspace(-half, half, n_across + 1)
    front = np.column_stack([np.full(n_across + 1, root), across])
    outline = np.vstack([side[:-1] * [1, -1], front, side[-2::-1]])
    angle = np.linspace(-pitch, pitch, n_around + 1)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])

    radii = _steps(hole_radius, centre_radius, size / 2.0)
    centre = radii[:, None, None] * circle
    arc = 2.0 * pitch * centre_radius / n_around
    # By the narrowest gap, to avoid slivers there.
    gap = np.linalg.norm(outline - centre[-1], axis=1).min()
    share = _graded(gap, arc, size)[1:, None, None]
    fan = np.concatenate([centre, (1.0 - share) * centre[-1] + share * outline])

    free, end = _steps(root, begin, size), _steps(begin, length, size)
    s = np.concatenate([free[1:], end[1:]])
    strip = np.full((len(s), n_around + 1, 2), np.nan)
    middle = slice(n_side, n_side + n_across + 1)
    strip[:, middle] = np.stack(np.broadcast_arrays(s[:, None], across), axis=-1)

    points = np.concatenate([fan, strip])
    exists = ~np.isnan(points[:, :, 0])
    used = exists[1:, 1:] & exists[1:, :-1]
    return _Sector(points, used, len(radii) - 1, len(fan) - 1, len(end) - 1)


def _steps(start: float, stop: float, size: float) -> Float[HostArray, " n"]:
    """Divide a length into equal steps of about a size, at least one."""
    return np.linspace(start, stop, max(1, round((stop - start) / size)) + 1)


def _graded(length: float, first: float, last: float) -> Float[HostArray, " n"]:
    """Divide a length, scaled to 1, into steps that grow from one size to another."""
    n = max(1, round(length / math.sqrt(first * last)))
    growth = np.geomspace(first, last, n)
    return np.concatenate([[0.0], np.cumsum(growth) / growth.sum()])


def _extruded(
    sector: _Sector, branches: int, levels: Float[HostArray, " n_levels"]
) -> TetMesh:
    """Extrude the sheet to linear tets with the groups of its cells."""
    n_rows, n_columns = sector.points.shape[:2]
    around = branches * (n_columns - 1)
    cells = np.argwhere(np.tile(sector.used, (len(levels) - 1, 1, branches)))
    # Seen from the notch, so that its wide cells are cut through the notch.
    seen = cells + np.array([0, sector.n_fan, 0])
    nodes = cells[:, None, None] + kuhn_tets(seen) // 2
    nodes[..., 2] %= around
    grid = (len(levels), n_rows, around)
    indices = np.ravel_multi_index(tuple(np.moveaxis(nodes, -1, 0)), grid)
    used, tets = np.unique(indices, return_inverse=True)
    level, row, column = np.unravel_index(used, grid)
    branch, column = np.divmod(column, n_columns - 1)
    x, z = sector.points[row, column].T
    azimuth = 2.0 * np.pi * branch / branches
    c, s = np.cos(azimuth), np.sin(azimuth)
    points = np.column_stack([c * x - s * z, levels[level], s * x + c * z])
    # Rows, columns and levels form a left-handed frame.
    tets = tets.reshape(-1, 4)
    tets = oriented(tets, points[tets])
    row, branch = cells[:, 1], cells[:, 2] // (n_columns - 1)
    at_end = row >= n_rows - 1 - sector.n_end
    groups = {f"end {k + 1}": at_end & (branch == k) for k in range(branches)}
    groups["centre"] = row < sector.n_centre
    members = {name: np.flatnonzero(np.repeat(w, 6)) for name, w in groups.items()}
    nodes = {name: np.unique(tets[chosen]) for name, chosen in members.items()}
    return TetMesh(points, tets, nodes, tet_groups=members)
