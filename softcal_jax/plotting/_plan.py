"""Draw what a project describes, before anything is solved."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import (
    BodyFrame,
    Configuration,
    ConfigurationArrays,
    EffectorRecord,
    configuration_lanes,
    farthest,
    motions,
)
from softcal_jax.equilibrium import Model, RobotState, actuator_states
from softcal_jax.mesh import boundary_faces
from softcal_jax.plotting import _figure as figures, _robot as robots, _view as views
from softcal_jax.plotting._figure import Axes, PictureStyle, symbol
from softcal_jax.plotting._view import View

MOST_PANELS = 6
"""Most configurations that are drawn; `softcal check` says how many are left out."""

_HEADING = 44  # height of the heading of a panel [pixels]
_LOWEST, _HIGHEST, _PAGE = 330, 820, 1100  # limits of the height of a panel, of all
_MARGIN = 80  # room around the body for symbols and their names [pixels]
_MOST_FIBRES = 400  # fibres that are drawn, in tets at the visible boundary
_MOST_NAMES = 12  # markers that are named; more names would cover each other
_LIGHT, _DARK = 0.97, 0.70  # brightness of a face seen from the front, the side


def plot_plan(
    model: Model,
    headings: Mapping[str, str],
    configurations: Sequence[Configuration],
    path: str | Path,
    *,
    title: str = "",
    subtitle: str = "",
    control_points: Float[HostArray, "n_cp 3"] | None = None,
    software: str = "softcal_jax",
    style: PictureStyle = figures.SCREEN,
) -> None:
    """Draw the body at rest, with all that acts on it and all that is measured.

    Each of the first `MOST_PANELS` configurations has a panel below its heading; all
    have the same camera. Control points are numbered from 1 [m]. A point that was
    measured far away, see `farthest`, is left out. Needs no OpenGL.
    """
    mesh, fibres = model.mesh, None
    if families := model.law.fibres():
        stiffness = np.asarray(getattr(model.law, "E_f", 1.0))
        # None is seen where the fibre has no stiffness.
        fibres = families[0].of_tets(mesh.n_tets) * (stiffness > 0.0)[..., None]
    shown = configurations[:MOST_PANELS]
    alone = [replace(c, after=None) for c in shown]
    lanes = configuration_lanes(mesh, alone, model.mechanism)
    markers = [[p for p in rows if p.quantity == "point"] for rows in lanes.effectors]
    pictures = [
        _at_rest(model, c, lanes.arrays[k], markers[k]) for k, c in enumerate(shown)
    ]
    numbered = np.zeros((0, 3)) if control_points is None else control_points
    more = [numbered, *(picture.points for picture in pictures)]
    for points in markers:
        more += [p.at_rest for p in points]
        more += [place for place, _ in _measured(model, points)]
    gravity = shown[0].gravity if shown else ()
    view = views.choose_view(mesh.points, None, more, gravity, style.seen_from)
    n = len(shown)

    def fit(columns: int) -> tuple[float, int]:
        """Fit the body into each panel, as large as the page allows."""
        highest = max(_LOWEST, min(_HIGHEST, _PAGE // math.ceil(n / columns)))
        width = style.pixels // columns
        return views.fit_body(view, width, _MARGIN, _LOWEST, highest)

    columns = max(range(1, n + 1), key=lambda columns: fit(columns)[0])
    width, (scale, height) = style.pixels // columns, fit(columns)
    total = math.ceil(n / columns) * (height + _HEADING)
    faces = views.visible_faces(mesh, view)
    light = _DARK + (_LIGHT - _DARK) * faces.light
    grey = np.repeat(light[:, None], 3, axis=1)
    drawn = {"control point"} if len(numbered) else set()
    ratio = total / style.pixels
    with figures.printed(path, style, height=ratio, software=software) as figure:
        for k, c in enumerate(shown):
            row, column = divmod(k, columns)
            bottom = total - (row + 1) * (height + _HEADING)
            box = column * width, bottom, width, height
            axes = figures.add_view(figure, *box, scale=scale)
            figures.draw_faces(axes, view, faces.corners, grey)
            if fibres is not None:
                _draw_fibres(axes, view, faces, fibres)
                drawn.add("fibre")
            drawn |= _draw_configuration(axes, view, c, pictures[k], markers[k])
            figures.draw_control_points(axes, view.project(numbered))
            look = {"color": figures.TEXT, "parse_math": False}
            figures.shrink(axes.set_title(headings[c.name], **look), width - 40)
        words = {"title": title, "subtitle": subtitle}
        figures.draw_frame(figure, view, figures.legend_of(drawn), scale=scale, **words)


def _measured(
    model: Model, points: Sequence[EffectorRecord]
) -> list[tuple[HostArray, HostArray]]:
    """Pair measured places with those at rest, without points measured far away [m]."""
    return [
        (np.where(p.seen, p.measured, p.at_rest), p.at_rest)
        for p in points
        if p.seen.any() and farthest(motions([p]), model.mesh.size) is None
    ]


def _at_rest(
    model: Model,
    c: Configuration,
    lane: ConfigurationArrays,
    points: Sequence[EffectorRecord],
) -> robots.RobotPicture:
    """Collect what is drawn of a configuration as it is imposed, undeformed."""
    obstacles = robots.obstacles_at_start(model, lane.bodies)
    lane = jax.device_get(lane)
    asked, by_displacement = lane.actuation.value, lane.actuation.by_displacement
    forces = np.where(by_displacement, np.nan, asked)
    displacements = np.where(by_displacement, asked, np.nan)
    actuators = actuator_states(model, lane, forces, displacements)
    still = np.zeros_like(model.mechanism.points)
    state = RobotState((), actuators, (), (), still)
    frames = {e.name for e in c.effectors if isinstance(e, BodyFrame)}
    sensors = [
        robots.SensorFrame(p.at_rest, np.eye(3)) for p in points if p.name in frames
    ]
    return robots.picture_of(model, state, c, sensors, obstacles)


def _draw_configuration(
    axes: Axes,
    view: View,
    c: Configuration,
    picture: robots.RobotPicture,
    points: Sequence[EffectorRecord],
) -> set[str]:
    """Draw one configuration; return what was drawn, for the legend."""
    model = picture.model
    robots.draw_obstacles(axes, view, picture)
    _draw_bodies(axes, view, model, c)
    drawn = {"obstacle"} if picture.obstacles else set()
    drawn |= {"rigid body"} if model.mechanism.bodies.has_nodes.any() else set()
    drawn |= robots.draw_robot(axes, view, picture)
    for place, rest in _measured(model, points):
        ends = view.project(np.stack([rest, place]))
        axes.plot(*ends[1], path_effects=figures.halo(5.0), **symbol("measured"))
        axes.plot(*ends.T, **symbol("distance"))
        drawn.add("measured")
    for p in points:
        flat = view.project(p.at_rest)
        style = symbol("point at rest")
        axes.plot(*flat, path_effects=figures.halo(5.0), **style)
        if len(points) <= _MOST_NAMES:
            figures.draw_name(axes, p.name, flat, (9, 7), fontsize="small")
        drawn.add("point at rest")
    figures.separate_names(axes)
    return drawn


def _draw_bodies(axes: Axes, view: View, model: Model, c: Configuration) -> None:
    """Draw the nodes of rigid bodies as a patch, with name and state."""
    bodies, mesh = model.mechanism.bodies, model.mesh
    faces = boundary_faces(mesh)[:, :3]
    for k in np.flatnonzero(bodies.has_nodes):
        name, nodes = bodies.names[k], bodies.attached[bodies.body == k]
        covered = faces[np.isin(faces, nodes).all(axis=1)]
        style = {"facecolor": figures.RIGID, "edgecolor": figures.FAINT, "alpha": 0.75}
        figures.draw_patch(axes, view, mesh.points[covered], **style)
        flat = view.project(mesh.points[nodes])
        if not len(covered):
            axes.plot(*flat.T, "o", ms=figures.in_points(4.0), color=figures.FAINT)
        state = c.bodies.get(name)
        kind = state if isinstance(state, str) else getattr(state, "kind", "held")
        text = name if state is None else f"{name} ({kind})"
        place = (flat[:, 0].mean(), flat[:, 1].max())
        figures.draw_name(axes, text, place, (0, 9), ha="center", fontsize="small")


def _draw_fibres(
    axes: Axes,
    view: View,
    faces: views.VisibleFaces,
    fibres: Float[HostArray, "n_tets 3"],
) -> None:
    """Draw fibres of some of the tets whose outer face is seen."""
    from matplotlib.collections import LineCollection

    sides = faces.corners[:, 1:] - faces.corners[:, :1]
    areas = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    half = max(0.5 * np.sqrt(np.median(areas)), 0.008 * view.width)
    some = np.flatnonzero(np.any(fibres[faces.tet] != 0.0, axis=1))
    some = some[:: max(1, math.ceil(some.size / _MOST_FIBRES))]
    centres, along = faces.corners[some].mean(axis=1), half * fibres[faces.tet[some]]
    lines = view.project(np.stack([centres - along, centres + along], axis=1))
    axes.add_collection(LineCollection(list(lines), **symbol("fibre"), alpha=0.8))
