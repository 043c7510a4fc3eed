"""A mesh and its groups in words."""

import numpy as np

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
    width = max(
        map(len, [*mesh.surface_groups, *mesh.tet_groups, *mesh.node_groups, ""])
    )
    for name, faces in mesh.surface_groups.items():
        centres = mesh.points[faces[:, :3]].mean(axis=1)
        areas = face_shares(mesh, faces).sum(axis=1)
        mean = np.average(centres, axis=0, weights=areas)
        point = centres[np.argmin(np.linalg.norm(centres - mean, axis=1))]
        lines.append(
            f"  {name:<{width}}  {1e6 * areas.sum():.1f} mm2, a point on it: "
            f"{_in_mm(point)}"
        )
    for name, tets in mesh.tet_groups.items():
        own = readable_values([float(volumes(mesh)[tets].sum())], "m3")
        lines.append(f"  {name:<{width}}  {len(tets)} tets, {own}")
    for name, nodes in mesh.node_groups.items():
        if name not in mesh.surface_groups and name not in mesh.tet_groups:
            lines.append(f"  {name:<{width}}  {len(nodes)} nodes")
    return lines


def _in_mm(point: Float[HostArray, "3"]) -> str:
    return '"(' + ", ".join(f"{1e3 * x:.4g}" for x in point) + ') mm"'
