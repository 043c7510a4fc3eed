"""Bodies with a cavity, frames of rigid bodies, and motions of both."""

import equinox as eqx
import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax import actuators
from softcal_jax.actuators import actuator_arrays
from softcal_jax.mesh import TetMesh, beam, boundary_faces, to_quadratic

TURN = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
AXIS_LENGTH = 0.3

# One program each, in place of one for each operation in them.
actuator_displacements = eqx.filter_jit(actuators.actuator_displacements)
actuator_rows = eqx.filter_jit(actuators.actuator_rows)
curvature_entries = eqx.filter_jit(actuators.curvature_entries)


def hollow(full, dropped, order=1):
    """A box without some of its tets; what their removal bared is "cavity"."""
    used, tets = np.unique(full.tets[~dropped], return_inverse=True)
    mesh = TetMesh(full.points[used], tets.reshape(-1, 4))
    mesh = mesh if order == 1 else to_quadratic(mesh)
    faces, X = boundary_faces(mesh), mesh.points
    on_side = np.isclose(X, X.min(axis=0)) | np.isclose(X, X.max(axis=0))
    sides = on_side[faces].all(axis=1)
    surfaces = {
        "cavity": faces[~sides.any(axis=1)],
        "outer": faces[sides.any(axis=1)],
        "x_side": faces[sides[:, 0] & (X[faces][:, 0, 0] > 0.0)],
    }
    return TetMesh(X, mesh.tets, surface_groups=surfaces)


def hollow_cube(cells=1, order=1, *, moved=lambda points: points):
    """Cube of side 1 about the origin, one layer of cells around a cubic cavity.

    The cavity is `cells` wide, its side cells / (cells + 2). `moved` maps all nodes.
    """
    n = cells + 2
    full = beam(1.0, 1.0, 1.0, (n, n, n), origin=(-0.5, -0.5, -0.5))
    centroids = full.points[full.tets].mean(axis=1)
    mesh = hollow(full, np.abs(centroids).max(axis=1) < 0.5 * cells / n, order)
    return TetMesh(moved(mesh.points), mesh.tets, surface_groups=mesh.surface_groups)


def with_frames(mesh, *frames):
    """Rest positions of the mesh's nodes and of frames (origin, axes in rows)."""
    nodes = [
        np.concatenate([origin[None], origin + AXIS_LENGTH * axes])
        for origin, axes in frames
    ]
    return np.concatenate([mesh.points, *nodes])


def arrays_of(mesh, *actuators):
    """Arrays of actuators on a mesh without rigid bodies."""
    return actuator_arrays(mesh, mesh.points, actuators, {})


def bent(points):
    """A smooth motion that is not affine."""
    x, y, z = points.T
    return points + 0.1 * np.stack([y * z + x**2, np.sin(x) - z, x * y - 0.5 * z], 1)


def area_vectors(points, faces):
    """Area times normal of flat faces."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    return 0.5 * np.cross(b - a, c - a)
