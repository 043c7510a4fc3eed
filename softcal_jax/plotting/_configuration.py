"""Draw one configuration, or a mesh with its named groups.

VTK draws the body, and Matplotlib draws text, markers and scales over and around it, so
that markers inside or behind the body are visible and no texts overlap.
"""

import colorsys
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax._units import readable
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.equilibrium import Model
from softcal_jax.mesh import CAD_FACE, TetMesh, boundary_faces
from softcal_jax.plotting import _figure as figures, _robot as robots, _view as views
from softcal_jax.plotting._figure import Axes, PictureStyle, in_points
from softcal_jax.plotting._scene import body_image
from softcal_jax.plotting._view import View, VisibleFaces

Colour = tuple[float, float, float]

_COLUMNS, _HEADING = 2, 40  # of panels; height of a heading [pixels]
_ROOM = 1.15  # room for the body and names, over its width and height
_DARKEST, _PALE = 0.72, 0.25  # brightness seen from the side, share of white in colours
_PLAIN, _CUT = -1, -2
"""Group numbers of faces in no group: on the surface, and where the body is cut. As
indices from the end they pick from `_NO_GROUP`, which follows the groups' colours."""

_NO_GROUP = ((0.8, 0.8, 0.75), (0.92, 0.92, 0.92))
"""Colours of what is cut, and of other faces in no group."""

_GOLDEN = 0.618  # step around the wheel that keeps any number of colours apart
_LEAST = 30  # pixels of a group that are seen where its name stands


def plot_groups(
    mesh: TetMesh,
    path: str | Path,
    *,
    title: str = "",
    style: PictureStyle = figures.SCREEN,
) -> None:
    """Draw a mesh [m] with every group named and coloured, as PNG, SVG or PDF.

    Four panels show it from the front and from behind, and its halves after a cut, with
    the walls of cavities. A face in several groups has the colour of the last; a group
    that is seen in no panel is called hidden. Groups of nodes alone are dots.
    """
    from matplotlib.patches import Patch

    faced = {**mesh.tet_groups, **mesh.surface_groups}
    # Groups that a user has named get the colours that are farthest apart.
    is_unnamed = lambda name: CAD_FACE.fullmatch(name) is not None
    groups = sorted(faced | mesh.node_groups, key=is_unnamed)
    n = len(groups)
    colours = dict(zip(groups, _colours(n), strict=True))
    panels = _panels(mesh, style.seen_from)
    front = panels["from the front"][0]
    each = style.pixels // _COLUMNS
    panel = width, height, scale = views.fit_panel(front, each, _ROOM)
    shown = [_faces(mesh, groups, view, drawn) for view, drawn in panels.values()]
    images = [
        _image(view, faces, group, panel)
        for (view, _), (faces, group) in zip(panels.values(), shown, strict=True)
    ]
    seen = np.array([np.bincount(i[i >= 0], minlength=n)[:n] for i in images])
    total = len(panels) // _COLUMNS * (height + _HEADING)
    with figures.printed(path, style, height=total / style.pixels) as figure:
        for k, (heading, (view, drawn)) in enumerate(panels.items()):
            row, column = divmod(k, _COLUMNS)
            bottom = total - (row + 1) * (height + _HEADING)
            left = column * each + (each - width) // 2
            axes = figures.add_view(figure, left, bottom, width, height, scale=scale)
            axes.set_title(heading)
            faces, group = shown[k]
            # Darker where they are seen from the side.
            light = _DARKEST + (1.0 - _DARKEST) * faces.light
            shades = np.array([*colours.values(), *_NO_GROUP])[group] * light[:, None]
            figures.draw_faces(axes, view, faces.corners, shades)
            _draw_nodes(axes, view, mesh, drawn, colours)
            best = (seen.argmax(axis=0) == k) & (seen[k] >= _LEAST)
            for index in np.flatnonzero(best):
                # Amidst its pixels, and on one of them.
                places = np.argwhere(images[k] == index)[:, ::-1]
                off = np.linalg.norm(places - places.mean(axis=0), axis=1)
                nearest = places[np.argmin(off)] + 0.5
                place = (nearest - 0.5 * np.array([width, height])) / scale
                look = {"ha": "center", "va": "center"}
                figures.draw_name(axes, groups[index], place, (0, 0), **look)
        handles = []
        for (name, colour), pixels in zip(colours.items(), seen.T, strict=True):
            hidden = " (hidden)" if name in faced and not pixels.any() else ""
            handles.append(Patch(color=colour, label=name + hidden))
        figures.draw_frame(figure, front, handles, scale=scale, title=title)


def _panels(
    mesh: TetMesh, seen_from: Sequence[float] | None = None
) -> dict[str, tuple[View, Bool[HostArray, " n_tets"]]]:
    """Choose the views, and the tets that each shows, by their headings."""
    front = views.choose_view(mesh.points, seen_from=seen_from)
    behind = front._replace(right=-front.right, towards=-front.towards)
    middle = mesh.points.mean(axis=0)
    axes = np.linalg.svd(mesh.points - middle, full_matrices=False)[2]
    across = axes[np.argmax(np.abs(axes @ front.towards))]
    beyond = (mesh.centroids - middle) @ across * (across @ front.towards) < 0.0
    whole = np.ones(mesh.n_tets, bool)
    return {
        "from the front": (front, whole),
        "from behind": (behind, whole),
        "cut, from the front": (front, beyond),
        "cut, from behind": (behind, ~beyond),
    }


def _image(
    view: View,
    faces: VisibleFaces,
    group: Int[HostArray, " n_faces"],
    panel: tuple[int, int, float],
) -> Int[HostArray, "_ _"]:
    """Draw the number of the group that is seen at each pixel, negative for none."""
    from PIL import Image, ImageDraw

    width, height, scale = panel
    pixels = scale * view.project(faces.corners) + np.array([0.5 * width, 0.5 * height])
    image = Image.new("I", (width, height), -1)
    draw = ImageDraw.Draw(image)
    for corners, index in zip(pixels, group.tolist(), strict=True):
        draw.polygon([tuple(corner) for corner in corners.tolist()], fill=index)
    return np.asarray(image)


def _colours(n: int) -> list[Colour]:
    """Choose n colours."""
    from matplotlib.colors import to_rgb

    wheel = lambda k: colorsys.hsv_to_rgb(_GOLDEN * k % 1.0, 0.65, 0.9 - 0.2 * (k % 2))
    full = [to_rgb(c) for c in figures.SERIES[:n]]
    full += [wheel(k) for k in range(len(full), n)]
    pale = lambda share: _PALE + (1.0 - _PALE) * share
    return [(pale(r), pale(g), pale(b)) for r, g, b in full]


def _faces(
    mesh: TetMesh, groups: list[str], view: View, drawn: Bool[HostArray, " n_tets"]
) -> tuple[VisibleFaces, Int[HostArray, " n_faces"]]:
    """Find what is seen of some of the tets, and the group that colours each face."""
    part = TetMesh(mesh.points, mesh.tets[drawn])
    faces = views.visible_faces(part, view)
    tets, keys = np.flatnonzero(drawn)[faces.tet], _keys(mesh, faces.nodes)
    outside = np.isin(keys, _keys(mesh, boundary_faces(mesh)))
    group = np.where(outside, _PLAIN, _CUT)
    for name, members in mesh.tet_groups.items():
        group[np.isin(tets, members)] = groups.index(name)
    for name, members in mesh.surface_groups.items():
        group[np.isin(keys, _keys(mesh, members))] = groups.index(name)
    return faces, group


def _keys(mesh: TetMesh, faces: Int[HostArray, "n _"]) -> Int[HostArray, " n"]:
    """Compute a number for each face from its corners, in any order."""
    a, b, c = np.sort(faces[:, :3].astype(np.int64), axis=1).T
    return (a * mesh.n_nodes + b) * mesh.n_nodes + c


def _draw_nodes(
    axes: Axes,
    view: View,
    mesh: TetMesh,
    drawn: Bool[HostArray, " n_tets"],
    colours: dict[str, Colour],
) -> None:
    """Draw nodes of the drawn tets that belong to groups of nodes alone."""
    faced = {**mesh.surface_groups, **mesh.tet_groups}
    for name, members in mesh.node_groups.items():
        nodes = np.intersect1d(members, mesh.tets[drawn])
        if name in faced or not nodes.size:
            continue
        places = view.project(mesh.points[nodes])
        rim = {"mec": "black", "mew": in_points(0.5)}
        axes.plot(*places.T, "o", ms=in_points(5.0), color=colours[name], **rim)
        highest = places[np.argmax(places[:, 1])]
        figures.draw_name(axes, name, highest, (0, 14), ha="center")


_SIDE = 190  # width of the scale beside the body [pixels]
_LOWEST, _HIGHEST = 0.2625, 0.5625  # limits of the height of its part, over the width
_TALL = 600  # to which a part may rise where the picture is narrow [pixels]
_MARGIN = 60  # around the body, for marker symbols and names [pixels]


def render_configuration(
    model: Model,
    result: ConfigurationResult,
    path: str | Path,
    *,
    converged: bool = True,
    titled: bool = True,
    style: PictureStyle = figures.SCREEN,
) -> None:
    """Draw a configuration with its simulated and measured markers.

    Args:
        model: The model.
        result: The configuration, calibrated or simulated.
        path: PNG, SVG or PDF file.
        converged: Whether the calibration converged; if not, the picture says so.
        titled: Whether its name and errors stand above it.
        style: Width, size of words, resolution, and where the body is seen from.

    Raises:
        RenderingError: If the machine has no OpenGL that works without a screen.
    """
    measured, simulated = marker_places(result)
    render_body(
        model,
        result.displacement,
        path,
        title=result.name + _ROLES[result.role] if titled else "",
        subtitle=motion_words(result) if titled else "",
        measured=measured if result.role != "simulation" else None,
        simulated=simulated,
        marker_names=[p.name for p in result.points],
        labels=LABELS.get(result.role, LABELS[""]),
        warning="" if converged else NOT_CONVERGED,
        picture=robots.robot_picture(model, result),
        style=style,
    )


def marker_places(
    result: ConfigurationResult,
) -> tuple[Float[HostArray, "n 3"], Float[HostArray, "n 3"]]:
    """Return measured and simulated places of all points, NaN where there is none [m].

    A coordinate that was not measured does not contribute to the drawn distance.
    """
    points, none = result.points, np.full(3, np.nan)
    simulated = [p.simulated if result.converged else none for p in points]
    measured = [
        np.where(p.seen, p.measured, x)
        if p.seen.any() and result.role != "simulation"
        else none
        for p, x in zip(points, simulated, strict=True)
    ]
    return np.reshape(measured, (-1, 3)), np.reshape(simulated, (-1, 3))


NOT_CONVERGED = "NOT CONVERGED: do not use these values"
"""What stands above every picture of a calibration that did not converge."""

LABELS = {"": ("measured", "simulated")}
LABELS |= dict.fromkeys(("design", "command"), ("goal", "reached"))
"""What legends call measured and simulated points, by role, "" for any other."""

_ROLES = {
    "calibration": " - calibration (fitted)",
    "validation": " - validation (predicted, not fitted)",
    "prediction": " - predicted",
    "design": " - design",
    "command": " - inverse control",
    "simulation": "",
}


def motion_words(fit: ConfigurationResult) -> str:
    """Say how far the simulated markers are off, or how far a simulated body moves."""
    if fit.role == "simulation":
        moved = readable(fit.largest_displacement, "distance")
        return f"simulated; moves by up to {moved}"
    if not any(point.seen.any() for point in fit.points):
        return "no markers"
    none = "no equilibrium found"
    size = lambda rms: readable(rms, "distance") if math.isfinite(rms) else none
    text = size(fit.rms_after)
    if fit.role in ("design", "command"):
        return f"rms distance of the markers from their goals: {text}"
    if fit.role != "prediction":
        text = f"{size(fit.rms_before)} before, {text} after"
    text = f"rms residual of the markers: {text}"
    if math.isfinite(fit.rms_share):
        text += f" ({readable(fit.rms_share, 'share')} of their motion)"
    if math.isfinite(fit.turn_after):
        text += f"; orientations: {math.degrees(fit.turn_after):.2f} deg"
    return text


def render_body(
    model: Model,
    displacement: Float[HostArray, "n_nodes 3"],
    path: str | Path,
    *,
    title: str = "",
    subtitle: str = "",
    measured: Float[HostArray, "n_markers 3"] | None = None,
    simulated: Float[HostArray, "n_markers 3"] | None = None,
    marker_names: Sequence[str] = (),
    warning: str = "",
    picture: robots.RobotPicture | None = None,
    labels: tuple[str, str] = LABELS[""],
    style: PictureStyle = figures.SCREEN,
) -> None:
    """Draw a deformed body, coloured by displacement, over its outline at rest.

    Args:
        model: The model.
        displacement: Nodal displacement [m].
        path: PNG, SVG or PDF file.
        title: First line.
        subtitle: Second line.
        measured: Measured marker positions; rows with a NaN are left out [m].
        simulated: Simulated marker positions [m].
        marker_names: Names beside the markers.
        warning: Printed large and red above the title.
        picture: What acts on the body and stands beside it, as `robot_picture` collects
            it.
        labels: What the legend calls `measured` and `simulated`.
        style: Width, size of words, resolution, and where the body is seen from.

    Raises:
        RenderingError: If the machine has no OpenGL that works without a screen.
    """
    u = np.asarray(displacement, float)
    none = np.zeros((0, 3))
    measured = none if measured is None else measured
    simulated = none if simulated is None else simulated
    markers = np.concatenate([measured, simulated])
    more = [markers[np.isfinite(markers).all(axis=1)]]
    gravity = ()
    if picture is not None:
        more.append(picture.points)
        gravity = () if picture.posed is None else picture.posed.gravity
    view = views.choose_view(model.mesh.points, u, more, gravity, style.seen_from)
    pressure = np.zeros(1) if picture is None else picture.pressure
    touched = bool(pressure.any()) and style.pixels > 3 * _SIDE  # else there is no room
    width = style.pixels - _SIDE * (1 + touched)
    lowest, highest = _LOWEST * style.pixels, max(_HIGHEST * style.pixels, _TALL)
    scale, height = views.fit_body(view, width, _MARGIN, lowest, highest)
    largest = float(np.linalg.norm(u, axis=1).max())
    around = () if picture is None else picture.obstacles
    with figures.printed(path, style, height=height / style.pixels) as figure:
        pixels = body_image(
            model,
            u,
            view,
            size=(width, height),
            scale=scale,
            largest=largest,
            finer=style.dpi / figure.dpi,
            obstacles=robots.placed_surfaces(model, around),
            pressure=pressure if touched else None,
        )
        body = figures.add_view(figure, 0, 0, width, height, scale=scale)
        extent = (*body.get_xlim(), *body.get_ylim())
        body.imshow(pixels, extent=extent, interpolation="none")
        drawn = ["at rest"]
        called: dict[str, str] = dict(
            zip(("measured", "simulated"), labels, strict=True)
        )
        for name, points in zip(called, (measured, simulated), strict=True):
            if np.isfinite(points).all(axis=1).any():
                drawn.append(name)
        if {"measured", "simulated"} <= {*drawn}:
            drawn.append("distance")
        if model.mechanism.bodies.has_nodes.any():
            drawn.append("rigid body")
        if around:
            drawn.append("obstacle")
        if picture is not None:
            robots.name_obstacles(body, view, picture)
            drawn += robots.draw_robot(body, view, picture)
        flat = view.project(measured), view.project(simulated)
        figures.draw_markers(body, *flat, marker_names)
        figures.separate_names(body)
        bar = (width + 20, 0.06 * height, 28, 0.94 * height - 45)
        figures.draw_colour_scale(figures.add_axes(figure, *bar), 1e3 * largest)
        if touched:
            beside = figures.add_axes(figure, bar[0] + _SIDE, *bar[1:])
            of_contact = "contact pressure [kPa]", figures.PRESSURE_MAP
            figures.draw_colour_scale(beside, 1e-3 * pressure.max(), *of_contact)
        handles = figures.legend_of(drawn, called)
        words = {"title": title, "subtitle": subtitle, "warning": warning}
        figures.draw_frame(figure, view, handles, scale=scale, **words)
