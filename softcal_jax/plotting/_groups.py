"""Draw a mesh with its named groups: from the front, from behind, and cut open."""

import colorsys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.mesh import TetMesh, boundary_faces, boundary_tets
from softcal_jax.plotting import _annotations as annotations
from softcal_jax.plotting._colours import SERIES
from softcal_jax.plotting._view import View, choose_view

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

_DPI = 100
_SIZE, _TOP, _BOTTOM, _HEADING = 800, 90, 120, 40
"""Longer side of a panel, heights above and below all, and of a heading [pixels]."""

_ENTRY = (270, 34)
"""Width and height of an entry of the legend [pixels]."""

_MARGIN = 1.15
"""Room for the body and its names, over its own width and height."""

_DARKEST = 0.6
"""Brightness of a face seen from the side."""

_PLAIN, _SECTION = (0.92, 0.92, 0.92), (0.8, 0.8, 0.75)
"""Colours of faces in no group, and of what is cut."""

_GOLDEN = 0.618
"""Step around the colour wheel that keeps any number of colours apart [turns]."""


class _Faces(NamedTuple):
    """Faces that look towards the viewer, the farthest first.

    Attributes:
        corners: Their corners [m].
        light: Share of their area that is seen [-].
        area: Area that is seen [m2].
        group: Index of the group whose colour each has, -1 for none.
        cut: Whether they lie within the body, where it is cut.
    """

    corners: Float[HostArray, "n_faces 3 3"]
    light: Float[HostArray, " n_faces"]
    area: Float[HostArray, " n_faces"]
    group: Int[HostArray, " n_faces"]
    cut: Bool[HostArray, " n_faces"]

    def place(self, group: int) -> Float[HostArray, "3"]:
        """Choose where the name of a group stands: amidst its faces, on one of them."""
        own = self.group == group
        centres = self.corners[own].mean(axis=1)
        mean = np.average(centres, axis=0, weights=self.area[own])
        return centres[np.argmin(np.linalg.norm(centres - mean, axis=1))]


def plot_groups(mesh: TetMesh, path: str | Path, *, title: str = "") -> None:
    """Draw the body at rest with every group named and coloured, in three panels.

    From the front, from behind, and cut in the middle, where the walls of cavities
    show. A face in several groups has the colour of the last of them. Groups of nodes
    alone are dots, in all panels.

    Args:
        mesh: The mesh [m].
        path: PNG file.
        title: Title of the picture.
    """
    from matplotlib.figure import Figure

    groups = list({**mesh.tet_groups, **mesh.surface_groups, **mesh.node_groups})
    colours = _colours(len(groups))
    front = choose_view(mesh.points, np.zeros_like(mesh.points), np.zeros((0, 3)))
    behind = front._replace(right=-front.right, towards=-front.towards)
    whole = np.ones(mesh.n_tets, bool)
    half = (mesh.centroids - front.centre) @ front.towards < 0.0
    panels = {
        "from the front": (front, whole),
        "from behind": (behind, whole),
        "cut open": (front, half),
    }
    seen = [_faces(mesh, groups, *what) for what in panels.values()]
    weights = [np.bincount(f.group + 1, f.area, len(groups) + 1)[1:] for f in seen]
    best = np.argmax(weights, axis=0)

    extent = _MARGIN * np.array([front.width, front.height])
    width, height = np.maximum(_SIZE * extent / extent.max(), 0.5 * _SIZE).round()
    scale = max(extent[0] / width, extent[1] / height)
    columns = 1 if width > height else len(panels)
    rows = len(panels) // columns
    per_row = max(1, int(columns * width // _ENTRY[0]))
    legend = _ENTRY[1] * -(-len(groups) // per_row)
    size = np.array([columns * width, rows * (height + _HEADING)])
    size += [0.0, _TOP + legend + _BOTTOM]
    figure = Figure(figsize=tuple(size / _DPI), dpi=_DPI, facecolor="white")

    def axes(left, bottom, wide, high) -> "matplotlib.axes.Axes":
        """Add axes at a place in pixels, from the lower left corner."""
        x, y = size
        return figure.add_axes((left / x, bottom / y, wide / x, high / y))

    for k, ((heading, (view, _)), faces) in enumerate(
        zip(panels.items(), seen, strict=True)
    ):
        row, column = divmod(k, columns)
        bottom = size[1] - _TOP - (row + 1) * (height + _HEADING)
        own = axes(column * width, bottom, width, height)
        _draw_faces(own, view, faces, colours)
        _draw_nodes(own, view, mesh, groups, colours)
        for group in np.flatnonzero((best == k) & (weights[k] > 0.0)).tolist():
            place = view.project(faces.place(group)[None])[0]
            style = {"ha": "center", "va": "center"}
            annotations.draw_name(own, groups[group], place, (0, 0), **style)
        w, h = 0.5 * scale * np.array([width, height])
        own.set(xlim=(-w, w), ylim=(-h, h), title=heading)
        own.set_axis_off()
        own.title.set_fontsize(16)
    annotations.draw_title(axes(0, size[1] - _TOP, size[0], _TOP), title, "", "")
    _draw_legend(figure, groups, colours, per_row, (_BOTTOM + 0.5 * legend) / size[1])
    annotations.draw_triad(axes(10, 5, _BOTTOM - 10, _BOTTOM - 10), front)
    annotations.draw_length_scale(axes(size[0] - 270, 20, 250, 70), 250 * scale)
    figure.savefig(path, dpi=_DPI, format="png")


def _colours(n: int) -> list[tuple[float, ...]]:
    """Choose as many colours."""
    from matplotlib.colors import to_rgb

    wheel = lambda k: colorsys.hsv_to_rgb(_GOLDEN * k % 1.0, 0.65, 0.9 - 0.2 * (k % 2))
    return [to_rgb(SERIES[k]) if k < len(SERIES) else wheel(k) for k in range(n)]


def _faces(
    mesh: TetMesh, groups: list[str], view: View, drawn: Bool[HostArray, " n_tets"]
) -> _Faces:
    """Find what is seen of some of the tets."""
    part = TetMesh(mesh.points, mesh.tets[drawn])
    faces = boundary_faces(part)[:, :3]
    tets = np.flatnonzero(drawn)[boundary_tets(part)]
    corners = mesh.points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * normals @ view.towards
    light = 2.0 * area / np.linalg.norm(normals, axis=1)
    seen = np.flatnonzero(light > 0.0)
    order = seen[np.argsort(corners[seen].mean(axis=1) @ view.towards)]
    keys = _keys(mesh, faces[order])
    group = np.full(len(order), -1)
    for name, own in mesh.tet_groups.items():
        group[np.isin(tets[order], own)] = groups.index(name)
    for name, own in mesh.surface_groups.items():
        group[np.isin(keys, _keys(mesh, own))] = groups.index(name)
    cut = ~np.isin(keys, _keys(mesh, boundary_faces(mesh)))
    return _Faces(corners[order], light[order], area[order], group, cut)


def _keys(mesh: TetMesh, faces: Int[HostArray, "n _"]) -> Int[HostArray, " n"]:
    """Give each face a number, by its corners in any order."""
    corners = np.sort(faces[:, :3].astype(np.int64), axis=1).T
    return np.ravel_multi_index(tuple(corners), (mesh.n_nodes,) * 3)


def _draw_faces(
    axes: "matplotlib.axes.Axes",
    view: View,
    faces: _Faces,
    colours: list[tuple[float, ...]],
) -> None:
    from matplotlib.collections import PolyCollection

    flat = view.project(faces.corners.reshape(-1, 3)).reshape(-1, 3, 2)
    # The last two stand for the group -1, and for what is cut.
    table = np.array([*colours, _SECTION, _PLAIN])
    index = np.where(faces.cut & (faces.group < 0), len(colours), faces.group)
    light = _DARKEST + (1.0 - _DARKEST) * faces.light
    own = table[index] * light[:, None]
    edges = 0.8 * own
    axes.add_collection(PolyCollection(flat, facecolors=own, edgecolors=edges, lw=0.4))


def _draw_nodes(
    axes: "matplotlib.axes.Axes",
    view: View,
    mesh: TetMesh,
    groups: list[str],
    colours: list[tuple[float, ...]],
) -> None:
    """Draw the groups that are neither of faces nor of tets."""
    for name, nodes in mesh.node_groups.items():
        if name in mesh.surface_groups or name in mesh.tet_groups:
            continue
        places = view.project(mesh.points[nodes])
        colour = colours[groups.index(name)]
        axes.plot(*places.T, "o", ms=5, color=colour, mec="white", mew=0.6)
        middle = places[np.argmax(places[:, 1])]
        annotations.draw_name(axes, name, middle, (0, 14), ha="center")


def _draw_legend(
    figure: "matplotlib.figure.Figure",
    groups: list[str],
    colours: list[tuple[float, ...]],
    columns: int,
    height: float,
) -> None:
    from matplotlib.patches import Patch

    handles = [Patch(color=c, label=n) for n, c in zip(groups, colours, strict=True)]
    if handles:
        place = {"loc": "center", "bbox_to_anchor": (0.5, height)}
        figure.legend(
            handles=handles, ncols=columns, fontsize=15, frameon=False, **place
        )
