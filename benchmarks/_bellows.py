"""Half of a bellows finger: hollow folds in a row on a strip, that touch when inflated.

The plane y = 0 is its mirror, and so are the planes between folds, meshes included.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softcal_jax.mesh import TetMesh, beam, boundary_faces, to_quadratic

PITCH, WIDTH, HEIGHT = 12e-3, 7e-3, 14e-3
"""Distance of folds, half of their width, and height with the strip [m]."""

STRIP, SIDE, WALL = 3e-3, 2e-3, 1.5e-3
"""Thickness of the strip, of sides and roof, and of walls that touch [m]."""


class Cells(NamedTuple):
    """Cells along, across and up a cavity, and through each wall around it."""

    along: int = 2
    across: int = 2
    up: int = 3
    wall: int = 1


def bellows(
    n_folds: int,
    gap: float,
    cells: Cells | None = None,
    *,
    ends: bool = True,
    order: int = 2,
) -> TetMesh:
    """Mesh folds on a strip, the first from x = 0 to the pitch.

    Surface groups are "cavity", open at the mirror, "back" and "front", the walls of
    folds that face the base and the tip, "base" and "tip", all at the ends, and
    "mirror". Without `ends`, the base lies at x = 0 too.

    Args:
        n_folds: Number of folds.
        gap: Width of the gap between them [m].
        cells: How fine the mesh is; by default the coarsest.
        ends: Whether the strip goes on for half of a gap at both ends.
        order: 1 for linear tets, 2 for quadratic ones.
    """
    cells = cells or Cells()
    through = cells.wall
    half = _edges([0.0, gap / 2, gap / 2 + WALL], [through, through])
    inner = _edges([half[-1], PITCH - half[-1]], [cells.along])
    fold = np.concatenate([half, inner[1:], (PITCH - half)[::-1][1:]])
    x = np.unique(np.round([fold + k * PITCH for k in range(n_folds)], 12))
    x = x if ends else x[through:-through]
    y = _edges([0.0, WIDTH - SIDE, WIDTH], [cells.across, through])
    z = _edges([0.0, STRIP, HEIGHT - SIDE, HEIGHT], [through, cells.up, through])
    counts = np.array([len(x), len(y), len(z)]) - 1
    box = beam(1.0, 1.0, 1.0, counts)
    at = np.rint(box.points * counts).astype(int)
    points = np.stack([x[at[:, 0]], y[at[:, 1]], z[at[:, 2]]], axis=1)
    middle = points[box.tets].mean(axis=1)
    beside = np.abs(middle[:, 0] % PITCH - PITCH / 2)  # from the middle of a fold
    above = middle[:, 2] > STRIP
    hole = above & (beside < PITCH / 2 - gap / 2 - WALL)
    hole &= (middle[:, 1] < WIDTH - SIDE) & (middle[:, 2] < HEIGHT - SIDE)
    used, tets = np.unique(
        box.tets[~hole & ~(above & (beside > PITCH / 2 - gap / 2))], return_inverse=True
    )
    mesh = TetMesh(points[used], tets.reshape(-1, 4))
    mesh = mesh if order == 1 else to_quadratic(mesh)
    mesh = _named(mesh, gap)
    return mesh if ends else replace(mesh, points=mesh.points - [gap / 2, 0.0, 0.0])


def _edges(ends: list[float], counts: list[int]) -> np.ndarray:
    """Divide each of some intervals evenly [m]."""
    parts = [
        np.linspace(a, b, n + 1)[1:]
        for a, b, n in zip(ends, ends[1:], counts, strict=False)
    ]
    return np.concatenate([ends[:1], *parts])


def _named(mesh: TetMesh, gap: float) -> TetMesh:
    """Name the surfaces."""
    faces, points = boundary_faces(mesh), mesh.points
    X = points[faces]
    flat = lambda axis, value: np.isclose(X[..., axis], value, atol=1e-9).all(axis=1)
    along = X[..., 0] % PITCH
    end = lambda value: np.isclose(along, value, atol=1e-9).all(axis=1)
    high = X[..., 2].max(axis=1) > STRIP + 1e-9
    outer = flat(1, 0.0) | flat(1, WIDTH) | flat(2, 0.0) | flat(2, HEIGHT)
    inside = (along > gap / 2 + WALL - 1e-9) & (along < PITCH - gap / 2 - WALL + 1e-9)
    inside &= (X[..., 1] < WIDTH - SIDE + 1e-9) & (X[..., 2] > STRIP - 1e-9)
    inside &= X[..., 2] < HEIGHT - SIDE + 1e-9
    surfaces = {
        "cavity": inside.all(axis=1) & ~outer,
        "back": end(gap / 2) & high,
        "front": end(PITCH - gap / 2) & high,
        "base": flat(0, points[:, 0].min()),
        "tip": flat(0, points[:, 0].max()),
        "mirror": flat(1, 0.0),
    }
    for name, chosen in surfaces.items():
        mesh = mesh.with_surface_group(name, faces[chosen])
    return mesh
