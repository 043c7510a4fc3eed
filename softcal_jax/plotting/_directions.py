"""Draw directions of fibres on the surface of a body at rest."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax.mesh import TetMesh
from softcal_jax.plotting import _annotations as annotations
from softcal_jax.plotting._colours import SERIES
from softcal_jax.plotting._save import add_view, pixel_figure, save
from softcal_jax.plotting._view import View, VisibleFaces, choose_view, visible_faces

_SIZE, _TOP, _BOTTOM = 900, 110, 120
"""Longer side of the body, and heights above and below it [pixels]."""

_MARGIN = 1.08
"""Room for the body, over its own width and height."""

_DARKEST, _LIGHTEST = 0.72, 0.97
"""Grey of a face seen from the side, and from the front."""

_LENGTH, _BREADTH = 0.8, 0.1
"""Length and breadth of a line, over the root of twice the area of its face."""


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
    behind it, as it is seen in parallel projection: short where the fibre points out of
    the picture. So what a formula for the directions means is seen before anything is
    calibrated.

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
    extent = _MARGIN * np.array([view.width, view.height])
    width, height = np.maximum(_SIZE * extent / extent.max(), 0.5 * _SIZE).round()
    total = height + _TOP + _BOTTOM
    figure = pixel_figure(width, total)
    scale = min(width / extent[0], height / extent[1])
    body = add_view(figure, 0, _BOTTOM, width, height, scale=scale)
    body.add_collection(PolyCollection(shapes, facecolors=colours, edgecolors="face"))
    lines = [Line2D([], [], color=c, lw=4) for c in _colours_of(families)]
    place = {"loc": "center", "bbox_to_anchor": (0.5, 55 / total)}
    figure.legend(lines, families, fontsize=15, frameon=False, **place)
    around = {"scale": scale, "top": _TOP, "bottom": _BOTTOM}
    annotations.draw_frame(figure, view, **around, title=title)
    save(figure, path)


def _colours_of(families: Iterable[str]) -> list[str]:
    """List the colour of each family, from the first again where they are used up."""
    return [SERIES[i % len(SERIES)] for i, _ in enumerate(families)]


def _drawn(
    faces: VisibleFaces,
    view: View,
    families: Mapping[str, Float[HostArray, "n_tets 3"]],
    where: Bool[HostArray, " n_tets"],
) -> tuple[list[Float[HostArray, "n 2"]], list[tuple[float, ...]]]:
    """List polygons and their colours: each face, and upon it its lines.

    Nearer faces cover the lines of those behind them.
    """
    from matplotlib.colors import to_rgb

    light = _DARKEST + (_LIGHTEST - _DARKEST) * faces.light
    rgb = [to_rgb(colour) for colour in _colours_of(families)]
    shapes, colours = [], []
    for corners, grey, tet in zip(faces.corners, light, faces.tet, strict=True):
        flat = view.project(corners)
        shapes.append(flat)
        colours.append((grey,) * 3)
        if not where[tet]:
            continue
        sides = corners[1:] - corners[0]
        size = np.sqrt(np.linalg.norm(np.cross(*sides)))
        for vectors, colour in zip(families.values(), rgb, strict=True):
            u = vectors[tet] @ np.stack([view.right, view.up], axis=1)
            along = 0.5 * _LENGTH * size * u
            length = np.linalg.norm(along)
            if length > 0.0:
                across = 0.5 * _BREADTH * size / length * along[::-1] * (-1.0, 1.0)
                ends = [along + across, along - across, -along - across, across - along]
                shapes.append(flat.mean(axis=0) + ends)
                colours.append(colour)
    return shapes, colours
