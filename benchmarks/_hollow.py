"""Bodies with a cavity, for chambers."""

from collections.abc import Callable

import numpy as np

from softcal_jax.mesh import TetMesh, beam, boundary_faces, to_quadratic


def hollow(full: TetMesh, dropped: np.ndarray, order: int = 1) -> TetMesh:
    """Take tets out of a box; what their removal bared is "cavity"."""
    used, tets = np.unique(full.tets[~dropped], return_inverse=True)
    mesh = TetMesh(full.points[used], tets.reshape(-1, 4))
    mesh = mesh if order == 1 else to_quadratic(mesh)
    faces, X = boundary_faces(mesh), mesh.points
    low, high = X.min(axis=0), X.max(axis=0)
    on_side = np.asarray(np.isclose(X, low) | np.isclose(X, high))
    sides = np.all(on_side[faces], axis=1)
    surfaces = {
        "cavity": faces[~np.any(sides, axis=1)],
        "outer": faces[np.any(sides, axis=1)],
        "x_side": faces[sides[:, 0] & (X[faces][:, 0, 0] > 0.0)],
    }
    return TetMesh(X, mesh.tets, surface_groups=surfaces)


def hollow_cube(
    cells: int = 1,
    order: int = 1,
    *,
    moved: Callable[[np.ndarray], np.ndarray] = lambda points: points,
) -> TetMesh:
    """Make a cube of side 1 about the origin, one layer of cells around a cubic cavity.

    The cavity is `cells` wide, its side cells / (cells + 2). `moved` maps all nodes.
    """
    n = cells + 2
    full = beam(1.0, 1.0, 1.0, (n, n, n), origin=(-0.5, -0.5, -0.5))
    centroids = full.points[full.tets].mean(axis=1)
    mesh = hollow(full, np.abs(centroids).max(axis=1) < 0.5 * cells / n, order)
    return TetMesh(moved(mesh.points), mesh.tets, surface_groups=mesh.surface_groups)
