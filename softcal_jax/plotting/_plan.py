"""Draw what a project describes, before anything is solved, and its obstacles."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np
from scipy.spatial.distance import cdist

from softcal_jax._lanes import lane_of
from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax._units import readable_values
from softcal_jax.bodies import BodyStateArrays
from softcal_jax.configurations import (
    BodyFrame,
    Configuration,
    ConfigurationArrays,
    EffectorRecord,
    configuration_lanes,
    farthest,
    motions,
)
from softcal_jax.contact import ContactState, HalfSpace
from softcal_jax.equilibrium import Model, RobotState, actuator_states
from softcal_jax.export import fibre_directions
from softcal_jax.mesh import boundary_faces
from softcal_jax.plotting import _figure as figures, _robot as robots, _view as views
from softcal_jax.plotting._figure import (
    FAINT,
    OBSTACLE,
    RIGID,
    SCREEN,
    TEXT,
    Axes,
    PictureStyle,
    add_view,
    draw_name,
    draw_patch,
    in_points,
    printed,
    symbol,
)
from softcal_jax.plotting._view import View

if TYPE_CHECKING:
    import pyvista


_MOST = 2500  # triangles of a surface; more of them look the same
_COVER = 0.35  # opacity of an obstacle in a plan


class PlacedObstacle(NamedTuple):
    """An obstacle that is drawn.

    Attributes:
        number: Its index among the obstacles of the model.
        name: Its name, and the force on it at an equilibrium.
        origin: Place of the origin of its surface [m].
        axes: Directions of the axes of its surface, by rows [-].
    """

    number: int
    name: str
    origin: Float[HostArray, "3"]
    axes: Float[HostArray, "3 3"]

    def place(self, points: Float[HostArray, "n 3"]) -> Float[HostArray, "n 3"]:
        """Move points of its surface to where it stands [m]."""
        return self.origin + np.asarray(points, float) @ self.axes


def obstacles_at(model: Model, state: RobotState) -> list[PlacedObstacle]:
    """List the obstacles that are there at an equilibrium."""
    contacts = model.mechanism.contacts
    x = np.asarray(model.mechanism.points) + state.displacement
    felt = {contact.name: contact for contact in state.contacts}
    names = [_named(name, felt.get(name)) for name in contacts.names]
    present = np.array([name in felt for name in contacts.names], bool)
    return list(_placed(model, present, x[contacts.frames], names))


def _named(name: str, contact: ContactState | None) -> str:
    if contact is None or contact.area == 0.0:
        return name
    size = float(np.linalg.norm(contact.force))
    return f"{name}: {readable_values([size], 'N', digits=3)}"


def obstacles_at_start(model: Model, states: BodyStateArrays) -> list[PlacedObstacle]:
    """List the obstacles that are there before the load, in states of the bodies."""
    if model.mechanism.contacts.n_obstacles == 0:
        return []  # without compiling for it
    present, frames = jax.device_get(model.mechanism.standing(states))
    return list(_placed(model, present, frames, model.mechanism.contacts.names))


def _placed(
    model: Model,
    present: Bool[HostArray, " n_obstacles"],
    frames: Float[HostArray, "n_obstacles 4 3"],
    names: Sequence[str],
) -> Iterator[PlacedObstacle]:
    contacts, middle = model.mechanism.contacts, model.mesh.points.mean(axis=0)
    for k in np.flatnonzero(present).tolist():
        origin = frames[k, 0]
        axes = (frames[k, 1:] - origin) / contacts.length
        if isinstance(contacts.shapes[k], HalfSpace):
            # Its plate lies beside the body, wherever in the plane its origin is.
            origin = middle - axes[2] * (axes[2] @ (middle - origin))
        yield PlacedObstacle(k, names[k], origin, axes)


def obstacle_surface(model: Model, index: int) -> "pyvista.PolyData":
    """Make the surface of an obstacle in its frame, of few triangles [m]."""
    surface: Any = model.mechanism.contacts.shapes[index].drawn(model.mesh.size)
    surface = surface.triangulate()
    if surface.n_cells > _MOST:
        surface = surface.decimate(1.0 - _MOST / surface.n_cells)
    return surface


def placed_surfaces(
    model: Model, obstacles: Sequence[PlacedObstacle]
) -> "list[pyvista.PolyData]":
    """Make the surfaces of obstacles where they stand [m]."""
    surfaces = []
    for obstacle in obstacles:
        surface = obstacle_surface(model, obstacle.number)
        surface.points = obstacle.place(surface.points)
        surfaces.append(surface)
    return surfaces


def draw_obstacles(
    axes: Axes, view: View, model: Model, obstacles: Sequence[PlacedObstacle]
) -> None:
    """Draw obstacles by what is seen of their surfaces, behind or before the body."""
    depth = model.mesh.points.mean(axis=0) @ view.towards
    for surface in placed_surfaces(model, obstacles):
        corners = _seen(np.asarray(surface.points)[surface.regular_faces], view)
        behind = corners.mean(axis=(0, 1)) @ view.towards < depth
        style = {"facecolor": OBSTACLE, "edgecolor": "none", "alpha": _COVER}
        draw_patch(axes, view, corners, **style, zorder=0.5 if behind else 1.5)
    name_obstacles(axes, view, model, obstacles)


def _seen(corners: Float[HostArray, "n 3 3"], view: View) -> Float[HostArray, "m 3 3"]:
    """Take the triangles on the side of the viewer, or all of what has one side."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middles = corners.mean(axis=1)
    outwards = np.sum(normals * (middles - middles.mean(axis=0)))
    towards = normals @ view.towards * np.sign(outwards or 1.0)
    return corners[towards > 0.0] if (towards > 0.0).any() else corners


def name_obstacles(
    axes: Axes, view: View, model: Model, obstacles: Sequence[PlacedObstacle]
) -> None:
    """Write the name of each obstacle where it is farthest from the body."""
    half = 0.9 * np.array([axes.get_xlim()[1], axes.get_ylim()[1]])
    body = view.project(model.mesh.points)
    surfaces = placed_surfaces(model, obstacles)
    for obstacle, surface in zip(obstacles, surfaces, strict=True):
        flat = view.project(np.asarray(surface.points))
        inside = np.all(np.abs(flat) <= half, axis=1)
        inside &= np.any(flat < 0.55 * half, axis=1)  # gravity is in that corner
        flat = flat[inside] if inside.any() else np.clip(flat, -half, half)
        place = flat[np.argmax(cdist(flat, body).min(axis=1))]
        style = {"ha": "center", "va": "center", "fontsize": "small", "color": FAINT}
        draw_name(axes, obstacle.name, place, (0, 0), **style)


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
    style: PictureStyle = SCREEN,
) -> None:
    """Draw the body at rest, with all that acts on it and all that is measured.

    Each of the first `MOST_PANELS` configurations has a panel below its heading; all
    have the same camera. Control points are numbered from 1 [m]. A point that was
    measured far away, see `farthest`, is left out. Needs no OpenGL.
    """
    mesh, fibres = model.mesh, next(iter(fibre_directions(model).values()), None)
    stiffness = getattr(model.law, "E_f", None)
    if fibres is not None and stiffness is not None:  # none to see where it is zero
        fibres = fibres * (np.broadcast_to(stiffness, len(fibres)) > 0.0)[:, None]
    shown = configurations[:MOST_PANELS]
    lanes = configuration_lanes(mesh, shown, model.mechanism)
    markers = [[p for p in rows if p.quantity == "point"] for rows in lanes.effectors]
    rests = [_at_rest(model, lanes.arrays[k]) for k in range(len(shown))]
    pictures = [robots.robot_picture(model, rest) for rest in rests]
    numbered = np.zeros((0, 3)) if control_points is None else control_points
    more = [numbered, *(picture.points for picture in pictures)]
    loads = [load for c in shown for load in c.loads]
    more += [robots.load_place(load, mesh, mesh.points)[0] for load in loads]
    for points in markers:
        more += [p.at_rest for p in points]
        more += [place for place, _ in _measured(model, points)]
    gravity = shown[0].gravity if shown else ()
    still = np.zeros_like(mesh.points)
    view = views.choose_view(
        mesh.points, still, np.vstack(more), gravity, style.seen_from
    )
    n = len(shown)
    fit = lambda columns: _fit(view, n, columns, style.pixels)
    columns = max(range(1, n + 1), key=lambda columns: fit(columns)[0])
    width, rows = style.pixels // columns, math.ceil(n / columns)
    scale, height = fit(columns)
    total = rows * (height + _HEADING)
    faces = views.visible_faces(mesh, view)
    light = _DARK + (_LIGHT - _DARK) * faces.light
    grey = np.repeat(light[:, None], 3, axis=1)
    drawn = {"control point"} if len(numbered) else set()
    if fibres is not None:
        drawn.add("fibre")
    ratio = total / style.pixels
    with printed(path, style, height=ratio, software=software) as figure:
        for k, c in enumerate(shown):
            row, column = divmod(k, columns)
            bottom = total - (row + 1) * (height + _HEADING)
            box = column * width, bottom, width, height
            axes = add_view(figure, *box, scale=scale)
            figures.draw_faces(axes, view, faces.corners, grey)
            if fibres is not None:
                _draw_fibres(axes, view, faces, fibres)
            around = obstacles_at_start(model, lane_of(lanes.arrays.bodies, k))
            draw_obstacles(axes, view, model, around)
            drawn |= {"obstacle"} if around else set()
            drawn |= _draw_configuration(axes, view, model, c, pictures[k], markers[k])
            figures.draw_control_points(axes, view.project(numbered))
            look = {"color": TEXT, "parse_math": False}
            figures.shrink(axes.set_title(headings[c.name], **look), width - 40)
        words = {"title": title, "subtitle": subtitle}
        handles = figures.legend_of(drawn)
        figures.draw_frame(figure, view, handles, scale=scale, **words)


def _fit(view: views.View, n: int, columns: int, width: int) -> tuple[float, int]:
    """Fit the body into each of n panels, as large as the page allows."""
    highest = max(_LOWEST, min(_HIGHEST, _PAGE // math.ceil(n / columns)))
    return views.fit_body(view, width // columns, _MARGIN, _LOWEST, highest)


def _measured(
    model: Model, points: Sequence[EffectorRecord]
) -> list[tuple[HostArray, HostArray]]:
    """Pair measured places with those at rest, without points measured far away [m]."""
    return [
        (np.where(p.seen, p.measured, p.at_rest), p.at_rest)
        for p in points
        if p.seen.any() and farthest(motions([p]), model.mesh.size) is None
    ]


def _at_rest(model: Model, lane: ConfigurationArrays) -> RobotState:
    """Describe the actuators of a configuration as they are imposed, undeformed."""
    lane = jax.device_get(lane)
    asked, by_displacement = lane.actuation.value, lane.actuation.by_displacement
    forces = np.where(by_displacement, np.nan, asked)
    displacements = np.where(by_displacement, asked, np.nan)
    states = actuator_states(model, lane, forces, displacements)
    return RobotState((), states, (), (), np.zeros_like(model.mechanism.points))


def _draw_configuration(
    axes: Axes,
    view: views.View,
    model: Model,
    c: Configuration,
    picture: robots.RobotPicture,
    points: Sequence[EffectorRecord],
) -> set[str]:
    """Draw one configuration; return what was drawn, for the legend."""
    _draw_bodies(axes, view, model, c)
    drawn = {"rigid body"} if model.mechanism.bodies.has_nodes.any() else set()
    drawn.update(robots.draw_setup(axes, view, c, model.mesh, model.mesh.points))
    drawn.update(robots.draw_robot(axes, view, picture))
    frames = {e.name for e in c.effectors if isinstance(e, BodyFrame)}
    sensors = [
        robots.SensorFrame(p.at_rest, np.eye(3)) for p in points if p.name in frames
    ]
    drawn.update(robots.draw_sensors(axes, view, sensors))
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


def _draw_bodies(axes: Axes, view: views.View, model: Model, c: Configuration) -> None:
    """Draw the nodes of rigid bodies as a patch, with name and state."""
    bodies, mesh = model.mechanism.bodies, model.mesh
    faces = boundary_faces(mesh)[:, :3]
    for k in np.flatnonzero(bodies.has_nodes):
        name, nodes = bodies.names[k], bodies.attached[bodies.body == k]
        covered = faces[np.isin(faces, nodes).all(axis=1)]
        style = {"facecolor": RIGID, "edgecolor": FAINT, "alpha": 0.75}
        figures.draw_patch(axes, view, mesh.points[covered], **style)
        flat = view.project(mesh.points[nodes])
        if not len(covered):
            axes.plot(*flat.T, "o", ms=in_points(4.0), color=FAINT)
        state = c.bodies.get(name)
        kind = state if isinstance(state, str) else getattr(state, "kind", "held")
        text = name if state is None else f"{name} ({kind})"
        place = (flat[:, 0].mean(), flat[:, 1].max())
        figures.draw_name(axes, text, place, (0, 9), ha="center", fontsize="small")


def _draw_fibres(
    axes: Axes,
    view: views.View,
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
