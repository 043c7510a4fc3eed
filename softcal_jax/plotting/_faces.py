"""Faces of a body that a viewer sees."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.mesh import TetMesh, boundary_faces, boundary_tets
from softcal_jax.plotting._view import View

if TYPE_CHECKING:
    import matplotlib.axes


class VisibleFaces(NamedTuple):
    """Faces that look towards the viewer, the farthest first.

    They have nodes at their corners [m], unit normals outwards, the share of their area
    that is seen, and the tet that each bounds.
    """

    nodes: Int[HostArray, "n_faces 3"]
    corners: Float[HostArray, "n_faces 3 3"]
    normal: Float[HostArray, "n_faces 3"]
    light: Float[HostArray, " n_faces"]
    tet: Int[HostArray, " n_faces"]


def visible_faces(mesh: TetMesh, view: View) -> VisibleFaces:
    """Find the faces of the boundary that look towards the viewer."""
    nodes = boundary_faces(mesh)[:, :3]
    corners = mesh.points[nodes]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    light = normal @ view.towards
    seen = np.flatnonzero(light > 0.0)
    seen = seen[np.argsort(corners[seen].mean(axis=1) @ view.towards)]
    tet = boundary_tets(mesh)[seen]
    return VisibleFaces(nodes[seen], corners[seen], normal[seen], light[seen], tet)


def draw_faces(
    axes: "matplotlib.axes.Axes",
    view: View,
    corners: Float[HostArray, "n_faces 3 3"],
    colours: Float[HostArray, "n_faces 3"],
) -> None:
    """Draw faces in their order, with edges a little darker; as pixels in SVG."""
    from matplotlib.collections import PolyCollection

    look = {"facecolors": colours, "edgecolors": 0.85 * colours, "lw": 0.4}
    shapes = list(view.project(corners))
    axes.add_collection(PolyCollection(shapes, **look, rasterized=True))
