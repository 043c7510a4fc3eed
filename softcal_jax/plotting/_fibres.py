"""Draw fibres: on the surface of a body, or in a layer of a print."""

from collections.abc import Mapping
from itertools import cycle
from pathlib import Path
from typing import Literal

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.mesh import TetMesh
from softcal_jax.plotting._figure import (
    DPI,
    FAINT,
    OUTLINE,
    SERIES,
    TEXT,
    Axes,
    add_view,
    draw_control_points,
    draw_frame,
    pixel_figure,
    save,
)
from softcal_jax.plotting._view import (
    View,
    VisibleFaces,
    choose_view,
    fit_panel,
    visible_faces,
)

_SIZE, _TOP, _BOTTOM = 900, 110, 120  # longer side of the body, above and below it [px]
_MARGIN = 1.08  # room for the body, over its own width and height
_DARKEST, _LIGHTEST = 0.72, 0.97  # grey of a face seen from the side, from the front
_LENGTH, _BREADTH = 0.8, 0.1  # of a line, over the root of twice the area of its face
_WIDTH, _SIDE = 14.0, 1.6  # of the figure of a layer, and of labels beside it [inches]
_MAP, _CYCLIC_MAP = "viridis", "twilight_shifted"
_CYCLIC_FROM = np.deg2rad(80.0)  # beyond, +90 and -90 degrees share a colour


def plot_directions(
    mesh: TetMesh,
    families: Mapping[str, Float[HostArray, "n_tets 3"]],
    path: str | Path,
    *,
    where: Bool[HostArray, " n_tets"] | None = None,
    title: str = "",
) -> None:
    """Draw directions of fibres as short lines on the surface of the body at rest.

    Each face that looks towards the viewer has a line along the direction in the tet
    behind it, in parallel projection: short where the fibre points out of the picture.

    Args:
        mesh: The mesh [m].
        families: Name of each family of fibres, and its unit vector in each tet [-], as
            `np.transpose(fibre.direction())` gives it.
        path: PNG or SVG file.
        where: Tets that have fibres; all by default.
        title: Title of the picture.

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
    view = choose_view(mesh.points, np.zeros_like(mesh.points), np.zeros((0, 3)))
    chosen = np.ones(mesh.n_tets, bool) if where is None else where
    shapes, colours = _drawn(visible_faces(mesh, view), view, families, chosen)
    width, height, scale = fit_panel(view, _SIZE, _MARGIN)
    total = height + _TOP + _BOTTOM
    figure = pixel_figure(width, total)
    body = add_view(figure, 0, _BOTTOM, width, height, scale=scale)
    body.add_collection(PolyCollection(shapes, facecolors=colours, edgecolors="face"))
    lines = [Line2D([], [], color=c, lw=4) for c, _ in zip(cycle(SERIES), families)]
    place = {"loc": "center", "bbox_to_anchor": (0.5, 55 / total)}
    figure.legend(lines, families, fontsize=15, frameon=False, **place)
    around = {"scale": scale, "top": _TOP, "bottom": _BOTTOM}
    draw_frame(figure, view, **around, title=title)
    save(figure, path)


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
        for vectors, colour in zip(families.values(), cycle(SERIES)):
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
) -> None:
    """Plot angles of the fibre in its print plane, one panel per field.

    Each tet of the middle layer of the mesh gets a line at its centroid along
    (cos theta, sin theta), over the outlines of these tets at rest. Panels of a long
    mesh are stacked, others stand side by side.

    Args:
        mesh: The mesh [m].
        panels: Title of each panel, and the angle of each tet [rad].
        path: PNG file, 1400 pixels wide, or SVG file.
        plane: Print plane, which is the plane of the picture.
        control_points: Positions to mark in every panel [m].
        title: Title of the figure.

    Raises:
        ValueError: If there is no panel, or a panel lacks one angle per tet.
    """
    import matplotlib
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    if not panels:
        raise ValueError("panels is empty: give at least one field of angles.")
    for name, theta in panels.items():
        if theta.shape != (len(mesh.tets),):
            raise ValueError(
                f"panel {name!r} needs one angle for each of the {len(mesh.tets)} "
                f"tets, got shape {theta.shape}."
            )
    columns = [0, "xyz".index(plane[1])]
    layer = middle_layer(mesh, 3 - sum(columns))
    largest = max(float(np.abs(theta).max()) for theta in panels.values())
    cyclic = largest > _CYCLIC_FROM
    limit = 90.0 if cyclic else max(np.rad2deg(largest), 1.0)
    colours = ScalarMappable(
        Normalize(-limit, limit), matplotlib.colormaps[_CYCLIC_MAP if cyclic else _MAP]
    )
    corners = mesh.points[mesh.tets[layer, :4]][:, :, columns]
    extent = np.ptp(mesh.points[:, columns], axis=0)
    # Stack the panels of a long mesh.
    stacked = extent[1] <= 0.5 * extent[0]
    shape = (len(panels), 1) if stacked else (1, len(panels))
    height = (_WIDTH - _SIDE) / shape[1] * extent[1] / extent[0]
    size = (_WIDTH, shape[0] * (min(height, 8.0) + 0.75) + 0.9)
    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    axes = figure.subplots(*shape, squeeze=False).ravel()
    for panel, (name, theta) in zip(axes, panels.items(), strict=True):
        _draw_layer(panel, corners, theta[layer], colours)
        if control_points is not None:
            draw_control_points(panel, 1e3 * control_points[:, columns])
        panel.set_title(name, fontsize=15, parse_math=False)
        panel.set_ylabel(f"{plane[1]} [mm]", fontsize=13)
        last = not stacked or panel is axes[-1]
        panel.tick_params(labelsize=11, labelbottom=last, bottom=last, colors=FAINT)
        panel.set_xlabel("x [mm]" if last else "", fontsize=13)
        panel.spines[:].set_visible(False)
    bar = figure.colorbar(colours, ax=list(axes), fraction=0.03, pad=0.02)
    bar.set_label("fibre angle theta [degrees]", fontsize=14, color=TEXT)
    bar.ax.tick_params(labelsize=12)
    if title:
        figure.suptitle(title, fontsize=18, weight="bold", parse_math=False)
    save(figure, path)


def middle_layer(mesh: TetMesh, normal: int) -> Int[HostArray, " n_layer"]:
    """Find the tets that the middle plane of the mesh cuts, normal to an axis."""
    heights = mesh.points[mesh.tets[:, :4], normal]
    low, high = mesh.points[:, normal].min(), mesh.points[:, normal].max()
    # A little off the middle, since faces of tets may lie exactly there.
    plane = 0.5 * (low + high) + 1e-6 * (high - low)
    cut = (heights.min(axis=1) < plane) & (heights.max(axis=1) > plane)
    return np.flatnonzero(cut)


def _draw_layer(
    axes: Axes,
    corners: Float[HostArray, "n_layer 4 2"],
    theta: Float[HostArray, " n_layer"],
    colours,
) -> None:
    from matplotlib.collections import LineCollection

    pairs = [(i, j) for i in range(4) for j in range(i)]
    edges = np.concatenate([corners[:, pair] for pair in pairs])
    edges = np.unique(np.round(np.sort(edges, axis=1), 9), axis=0)
    axes.add_collection(LineCollection(list(1e3 * edges), colors="#e4e4e4", lw=0.6))
    centres = corners.mean(axis=1)
    # As long as the distance between neighbours if they were spread evenly.
    area = np.prod(np.ptp(corners.reshape(-1, 2), axis=0))
    half = 0.5 * np.sqrt(area / len(centres))
    along = half * np.stack([np.cos(theta), np.sin(theta)], axis=1)
    lines = list(1e3 * np.stack([centres - along, centres + along], axis=1))
    shown = colours.to_rgba(np.rad2deg(theta))
    # A dark line below makes light colours visible on white.
    axes.add_collection(LineCollection(lines, colors="#303030", lw=2.6))
    axes.add_collection(LineCollection(lines, colors=list(shown), lw=1.7))
    low, high = 1e3 * corners.min(axis=(0, 1)), 1e3 * corners.max(axis=(0, 1))
    frame = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]
    axes.plot(*np.transpose([*frame, frame[0]]), color=OUTLINE, lw=1.2)
    margin = 0.04 * (high - low).min()
    axes.set(xlim=(low[0] - margin, high[0] + margin))
    axes.set(ylim=(low[1] - margin, high[1] + margin), aspect="equal")
