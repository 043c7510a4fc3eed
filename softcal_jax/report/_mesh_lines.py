"""A mesh and its groups in words."""

import numpy as np

from softcal_jax._text_table import aligned
from softcal_jax._typing import Float, HostArray
from softcal_jax.export import readable_values
from softcal_jax.mesh import TetMesh, face_shares, volumes


def mesh_lines(mesh: TetMesh) -> list[str]:
    """Describe a mesh in one line, and each group in one, surfaces with a point on it.

    Points are written as a project file has them.
    """
    corners = mesh.points[mesh.tets[:, :4]]
    edges = np.linalg.norm(corners[:, [1, 2, 3]] - corners[:, :1], axis=2)
    kind = "quadratic" if mesh.order == 2 else "linear"
    lines = [
        f"{mesh.n_nodes} nodes, {mesh.n_tets} {kind} tets, edges of "
        f"{readable_values([float(edges.mean())], 'm', digits=3)} in the mean, volume "
        f"{readable_values([float(volumes(mesh).sum())], 'm3')}"
    ]
    rows = []
    for name, faces in mesh.surface_groups.items():
        centres = mesh.points[faces[:, :3]].mean(axis=1)
        areas = face_shares(mesh, faces).sum(axis=1)
        mean = np.average(centres, axis=0, weights=areas)
        point = centres[np.argmin(np.linalg.norm(centres - mean, axis=1))]
        text = f"{1e6 * areas.sum():.1f} mm2, a point on it: {_in_mm(point)}"
        rows.append((name, text))
    for name, tets in mesh.tet_groups.items():
        volume = readable_values([float(volumes(mesh)[tets].sum())], "m3")
        rows.append((name, f"{len(tets)} tets, {volume}"))
    for name, nodes in mesh.node_groups.items():
        if name not in mesh.surface_groups and name not in mesh.tet_groups:
            rows.append((name, f"{len(nodes)} nodes"))
    return [*lines, *aligned(rows)]


def _in_mm(point: Float[HostArray, "3"]) -> str:
    return '"(' + ", ".join(f"{1e3 * x:.4g}" for x in point) + ') mm"'
