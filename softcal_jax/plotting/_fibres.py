"""Draw fibres: on the surface of a body, or in a layer of a print."""

from collections.abc import Mapping
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Literal

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.mesh import TetMesh
from softcal_jax.plotting import _figure as figures, _view as views
from softcal_jax.plotting._calibration import plot_panels
from softcal_jax.plotting._figure import Axes, PictureStyle, in_points
from softcal_jax.plotting._view import View, VisibleFaces

_MARGIN = 1.08  # room for the body, over its own width and height
_DARKEST, _LIGHTEST = 0.72, 0.97  # grey of a face seen from the side, from the front
_LENGTH, _BREADTH = 0.8, 0.1  # of a line, over the root of twice the area of its face
_MAP, _CYCLIC_MAP = "viridis", "twilight_shifted"
_CYCLIC_FROM = np.deg2rad(80.0)  # beyond, +90 and -90 degrees share a colour


def plot_directions(
    mesh: TetMesh,
    families: Mapping[str, Float[HostArray, "n_tets 3"]],
    path: str | Path,
    *,
    where: Bool[HostArray, " n_tets"] | None = None,
    title: str = "",
    style: PictureStyle = figures.SCREEN,
) -> None:
    """Draw directions of fibres as short lines on the surface of the body at rest.

    Each face that looks towards the viewer has a line along the direction in the tet
    behind it, in parallel projection: short where the fibre points out of the picture.

    Args:
        mesh: The mesh [m].
        families: Name of each family of fibres, and its unit vector in each tet [-], as
            `np.transpose(fibre.direction())` gives it.
        path: PNG, SVG or PDF file.
        where: Tets that have fibres; all by default.
        title: Title of the picture.
        style: Width, size of words, resolution, and where the body is seen from.

    Raises:
        ValueError: If there is no family, or one lacks a vector per tet.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.lines import Line2D

    if not families:
        raise ValueError("families is empty: give at least one field of directions.")
    for name, vectors in families.items():
        if vectors.shape != (mesh.n_tets, 3):
            raise ValueError(
                f"the family {name!r} needs one vector for each of the {mesh.n_tets} "
                f"tets, got shape {vectors.shape}."
            )
    view = views.choose_view(mesh.points, seen_from=style.seen_from)
    chosen = np.ones(mesh.n_tets, bool) if where is None else where
    shapes, colours = _drawn(views.visible_faces(mesh, view), view, families, chosen)
    width, height, scale = views.fit_panel(view, style.pixels, _MARGIN)
    with figures.printed(path, style, height=height / style.pixels) as figure:
        left = (style.pixels - width) // 2
        body = figures.add_view(figure, left, 0, width, height, scale=scale)
        faces = PolyCollection(shapes, facecolors=colours, edgecolors="face")
        body.add_collection(faces)
        lines = [
            Line2D([], [], color=colour, label=name, lw=in_points(4.0))
            for colour, name in zip(cycle(figures.SERIES), families)
        ]
        figures.draw_frame(figure, view, lines, scale=scale, title=title)


def _drawn(
    faces: VisibleFaces,
    view: View,
    families: Mapping[str, Float[HostArray, "n_tets 3"]],
    where: Bool[HostArray, " n_tets"],
) -> tuple[list[Float[HostArray, "n 2"]], list[tuple[float, ...]]]:
    """List polygons and their colours: each face, followed by the lines on it.

    Nearer faces cover the lines of those behind them.
    """
    from matplotlib.colors import to_rgb

    light = _DARKEST + (_LIGHTEST - _DARKEST) * faces.light
    shapes, colours = [], []
    for corners, grey, tet in zip(faces.corners, light, faces.tet, strict=True):
        flat = view.project(corners)
        shapes.append(flat)
        colours.append((grey,) * 3)
        if not where[tet]:
            continue
        sides = corners[1:] - corners[0]
        size = np.sqrt(np.linalg.norm(np.cross(*sides)))
        for vectors, colour in zip(families.values(), cycle(figures.SERIES)):
            u = vectors[tet] @ np.stack([view.right, view.up], axis=1)
            along = 0.5 * _LENGTH * size * u
            length = np.linalg.norm(along)
            if length > 0.0:
                across = 0.5 * _BREADTH * size / length * along[::-1] * (-1.0, 1.0)
                ends = [along + across, along - across, -along - across, across - along]
                shapes.append(flat.mean(axis=0) + ends)
                colours.append(to_rgb(colour))
    return shapes, colours


def plot_fibres(
    mesh: TetMesh,
    panels: Mapping[str, Float[HostArray, " n_tets"]],
    path: str | Path,
    *,
    plane: Literal["xy", "xz"],
    control_points: Float[HostArray, "n_cp 3"] | None = None,
    title: str = "",
    style: PictureStyle = figures.SCREEN,
) -> None:
    """Plot angles of the fibre in its print plane, one panel per field.

    Each tet of the middle layer of the mesh gets a line at its centroid along
    (cos theta, sin theta), over the outlines of these tets at rest. Panels of a long
    mesh are stacked, others stand side by side.

    Args:
        mesh: The mesh [m].
        panels: Title of each panel, and the angle of each tet [rad].
        path: PNG, SVG or PDF file.
        plane: Print plane, which is the plane of the picture.
        control_points: Positions to mark in every panel [m].
        title: Title of the figure.
        style: Width, size of words, resolution.

    Raises:
        ValueError: If there is no panel, or a panel lacks one angle per tet.
    """
    if not panels:
        raise ValueError("panels is empty: give at least one field of angles.")
    for name, theta in panels.items():
        if theta.shape != (len(mesh.tets),):
            raise ValueError(
                f"panel {name!r} needs one angle for each of the {len(mesh.tets)} "
                f"tets, got shape {theta.shape}."
            )
    largest = max(float(np.abs(theta).max()) for theta in panels.values())
    about = {"plane": plane, "largest": largest, "control_points": control_points}
    drawn = [
        partial(draw_fibres, mesh=mesh, theta=theta, title=name, **about)
        for name, theta in panels.items()
    ]
    extent = np.ptp(mesh.points[:, [0, "xyz".index(plane[1])]], axis=0)
    # Stack the panels of a long mesh.
    columns = 1 if extent[1] <= 0.5 * extent[0] else len(panels)
    plot_panels(path, drawn, columns=columns, style=style, title=title)


def middle_layer(mesh: TetMesh, normal: int) -> Int[HostArray, " n_layer"]:
    """Find the tets that the middle plane of the mesh cuts, normal to an axis."""
    heights = mesh.points[mesh.tets[:, :4], normal]
    low, high = mesh.points[:, normal].min(), mesh.points[:, normal].max()
    # A little off the middle, since faces of tets may lie exactly there.
    plane = 0.5 * (low + high) + 1e-6 * (high - low)
    cut = (heights.min(axis=1) < plane) & (heights.max(axis=1) > plane)
    return np.flatnonzero(cut)


def draw_fibres(
    axes: Axes,
    mesh: TetMesh,
    theta: Float[HostArray, " n_tets"],
    *,
    plane: Literal["xy", "xz"],
    largest: float | None = None,
    control_points: Float[HostArray, "n_cp 3"] | None = None,
    title: str = "",
) -> Axes:
    """Draw angles of the fibre in the middle layer of a mesh, as `plot_fibres` does.

    Args:
        axes: Where to draw.
        mesh: The mesh [m].
        theta: Angle of each tet [rad].
        plane: Print plane.
        largest: Angle at which the colours end; by default the largest [rad].
        control_points: Positions to mark [m].
        title: Title of the axes.

    Returns:
        The axes, with a colour bar beside them.
    """
    from matplotlib.collections import LineCollection

    columns = [0, "xyz".index(plane[1])]
    layer = middle_layer(mesh, 3 - sum(columns))
    corners = mesh.points[mesh.tets[layer, :4]][:, :, columns]
    largest = float(np.abs(theta).max()) if largest is None else largest
    cyclic = largest > _CYCLIC_FROM
    limit = 90.0 if cyclic else max(np.rad2deg(largest), 1.0)
    pairs = [(i, j) for i in range(4) for j in range(i)]
    edges = np.concatenate([corners[:, pair] for pair in pairs])
    edges = np.unique(np.round(np.sort(edges, axis=1), 9), axis=0)
    axes.add_collection(
        LineCollection(list(1e3 * edges), colors="#e4e4e4", lw=in_points(0.6))
    )
    centres = corners.mean(axis=1)
    # As long as the distance between neighbours if they were spread evenly.
    area = np.prod(np.ptp(corners.reshape(-1, 2), axis=0))
    half = 0.5 * np.sqrt(area / len(centres))
    along = half * np.stack([np.cos(theta[layer]), np.sin(theta[layer])], axis=1)
    lines = list(1e3 * np.stack([centres - along, centres + along], axis=1))
    # A dark line below makes light colours visible on white.
    axes.add_collection(LineCollection(lines, colors="#303030", lw=in_points(2.6)))
    look = {"cmap": _CYCLIC_MAP if cyclic else _MAP, "clim": (-limit, limit)}
    shown = LineCollection(lines, **look, lw=in_points(1.7))
    shown.set_array(np.rad2deg(theta[layer]))
    axes.add_collection(shown)
    axes.figure.colorbar(shown, ax=axes, label="theta [degrees]")
    axes.set_title(title, parse_math=False)
    low, high = 1e3 * corners.min(axis=(0, 1)), 1e3 * corners.max(axis=(0, 1))
    frame = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]
    look = {"color": figures.OUTLINE, "lw": in_points(1.2)}
    axes.plot(*np.transpose([*frame, frame[0]]), **look)
    margin = 0.04 * (high - low).min()
    axes.set(xlim=(low[0] - margin, high[0] + margin), xlabel="x [mm]")
    axes.set(ylim=(low[1] - margin, high[1] + margin), ylabel=f"{plane[1]} [mm]")
    axes.set_aspect("equal")
    axes.spines[:].set_visible(False)
    if control_points is not None:
        figures.draw_control_points(axes, 1e3 * control_points[:, columns])
    return axes
