"""Hollow spheres of curved quadratic tets, made without the package's generators."""

import numpy as np

from softcal_jax.elements import TET_EDGES
from softcal_jax.mesh import TetMesh, boundary_faces, to_quadratic

OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)])
OCTANTS = [(i, j, k) for i in (0, 3) for j in (1, 4) for k in (2, 5)]


def octahedron(n: int):
    """Vertices and triangles of an octahedron, its edges cut in n pieces."""
    vertices, triangles = [], []
    for octant in OCTANTS:
        a, b, c = OCTAHEDRON[list(octant)]
        at = {}
        for i in range(n + 1):
            for j in range(n + 1 - i):
                at[i, j] = len(vertices)
                vertices.append((i * a + j * b + (n - i - j) * c) / n)
        for i, j in at:
            if i + j < n:
                triangles.append([at[i, j], at[i + 1, j], at[i, j + 1]])
            if i + j < n - 1:
                triangles.append([at[i + 1, j], at[i + 1, j + 1], at[i, j + 1]])
    vertices, inverse = np.unique(np.round(vertices, 12), axis=0, return_inverse=True)
    return vertices, inverse.ravel()[np.array(triangles)]


def hollow_sphere(n: int, *, curved: bool = True) -> TetMesh:
    """Radii 1 and 2 about the origin: n cells on each octant's edge, n layers.

    Without `curved` a polyhedron of tets with straight edges. Mirrored by the three
    coordinate planes, diagonals included. Nodes on the planes are groups "x = 0", "y =
    0", "z = 0"; the surfaces are "inner" and "outer".
    """
    vertices, triangles = octahedron(n)
    # Diagonals start from the lowest vertex, ranked alike in all octants: neighbours
    # differ in some |coordinate|.
    rank = np.lexsort(np.abs(vertices).round(9).T)
    vertices, new = vertices[rank], np.argsort(rank)
    below = np.sort(new[triangles], axis=1)
    radii = np.linspace(1.0, 2.0, n + 1)
    m = len(vertices)
    on_sphere = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    points = np.concatenate([r * on_sphere for r in radii])
    # A prism a b c | A B C with a < b < c: three tets with diagonals aB, aC, bC.
    split = [[0, 1, 2, 5], [0, 1, 4, 5], [0, 3, 4, 5]]
    prisms = [np.hstack([below + k * m, below + (k + 1) * m]) for k in range(n)]
    tets = np.concatenate(prisms)[:, split].reshape(-1, 4)
    x = points[tets]
    left = np.linalg.det(x[:, 1:] - x[:, :1]) < 0.0
    tets[left] = tets[left][:, [0, 2, 1, 3]]
    mesh = to_quadratic(TetMesh(points, tets))
    # Mid nodes go out to the mean radius of their ends.
    points = mesh.points.copy()
    for ends, mid in zip(TET_EDGES, range(4, 10), strict=True) if curved else ():
        pair = mesh.points[mesh.tets[:, list(ends)]]
        radius = np.linalg.norm(pair, axis=2).mean(axis=1)
        middle = pair.mean(axis=1)
        scale = radius / np.linalg.norm(middle, axis=1)
        points[mesh.tets[:, mid]] = middle * scale[:, None]
    faces = boundary_faces(mesh)
    far = np.linalg.norm(points[faces[:, 0]], axis=1) > 1.5
    planes = {
        f"{axis} = 0": np.flatnonzero(np.abs(points[:, i]) < 1e-9)
        for i, axis in enumerate("xyz")
    }
    return TetMesh(
        points,
        mesh.tets,
        node_groups=planes,
        surface_groups={"inner": faces[~far], "outer": faces[far]},
    )
