"""Draw what a project describes, before anything is solved."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import (
    BodyFrame,
    Configuration,
    EffectorRecord,
    ImposedDisplacement,
    configuration_lanes,
    farthest,
    motions,
)
from softcal_jax.equilibrium import ActuatorState, Model, RobotState
from softcal_jax.materials import Fibre
from softcal_jax.mesh import boundary_faces
from softcal_jax.plotting import _annotations as annotations, _robot as robots
from softcal_jax.plotting._colours import FAINT, RIGID, SYMBOLS, TEXT
from softcal_jax.plotting._faces import VisibleFaces, draw_faces, visible_faces
from softcal_jax.plotting._robot import RobotPicture, SensorFrame
from softcal_jax.plotting._save import add_axes, pixel_figure, save
from softcal_jax.plotting._setup import draw_setup, load_points
from softcal_jax.plotting._view import View, choose_view

if TYPE_CHECKING:
    import matplotlib.axes

MOST_PANELS = 6
"""Most configurations that are drawn; the others are counted."""

_WIDTH, _TOP, _BOTTOM, _HEADING = 1600, 110, 140, 44
"""Whole width, and heights of title, legend and the heading of a panel [pixels]."""
_LOWEST, _HIGHEST, _PAGE = 330, 820, 1100
"""Limits of the height of a panel, and of all of them [pixels]."""
_MARGIN = 80
"""Room around the body for symbols and their names [pixels]."""

_MOST_FIBRES = 400
"""Most fibres that are drawn, of tets at the boundary that is seen."""

_MOST_NAMES = 12
"""Most markers that are named; more names would cover each other."""

_LIGHT, _DARK = 0.97, 0.70
"""Brightness of a face seen from the front, and from the side."""


class _Panel(NamedTuple):
    """A configuration as it is drawn, with its heading and the points to be seen."""

    configuration: Configuration
    heading: str
    records: tuple[EffectorRecord, ...]
    robot: RobotPicture
    points: Float[HostArray, "n 3"]


def plot_plan(
    model: Model,
    headings: Mapping[str, str],
    configurations: Sequence[Configuration],
    path: str | Path,
    *,
    title: str,
    subtitle: str = "",
    control_points: Float[HostArray, "n_cp 3"] | None = None,
    software: str = "softcal_jax",
) -> None:
    """Draw the body at rest with all that acts on it and is measured, unsolved.

    A panel for each configuration: supports, dead loads, gravity, actuators with what
    is imposed on them, rigid bodies, and markers at rest and where they were measured.
    All have the same camera. Fibres are drawn on the faces that are seen. A point that
    was measured far away, see `farthest`, is left out. Needs no OpenGL.

    Args:
        model: The model.
        headings: What stands above each configuration, by its name.
        configurations: The configurations; the first `MOST_PANELS` are drawn.
        path: PNG file, 1600 pixels wide, or SVG file.
        title: First line.
        subtitle: Second line.
        control_points: Control points, numbered from 1 [m].
        software: What drew it, which is kept in the file.
    """
    mesh, fibres = model.mesh, _fibre_directions(model)
    shown = configurations[:MOST_PANELS]
    lanes = configuration_lanes(mesh, shown, model.mechanism).effectors
    panels = [
        _panel(model, c, headings[c.name], records)
        for c, records in zip(shown, lanes, strict=True)
    ]
    more = [panel.points for panel in panels]
    if control_points is not None:
        more.append(control_points)
    view = choose_view(mesh.points, np.zeros_like(mesh.points), np.vstack(more))
    columns, rows, height, scale = _grid(view, len(panels))
    width = _WIDTH // columns
    total = _TOP + rows * (height + _HEADING) + _BOTTOM
    figure = pixel_figure(_WIDTH, total)
    faces = visible_faces(mesh, view)
    light = _DARK + (_LIGHT - _DARK) * faces.light
    grey = np.repeat(light[:, None], 3, axis=1)
    drawn: set[str] = set()
    for k, panel in enumerate(panels):
        row, column = divmod(k, columns)
        bottom = total - _TOP - (row + 1) * (height + _HEADING)
        own = add_axes(figure, column * width, bottom, width, height)
        w, h = 0.5 * width / scale, 0.5 * height / scale
        own.set(xlim=(-w, w), ylim=(-h, h))
        own.set_axis_off()
        draw_faces(own, view, faces.corners, grey)
        if fibres is not None:
            _draw_fibres(own, view, faces, fibres)
            drawn.add("fibre")
        drawn.update(_draw_panel(own, view, model, panel))
        for i, place in enumerate(() if control_points is None else control_points):
            flat = view.project(place)
            own.plot(*flat, **SYMBOLS["control point"])
            style = {"ha": "center", "va": "center", "fontsize": 10, "color": TEXT}
            own.text(flat[0], flat[1], str(i + 1), **style)
            drawn.add("control point")
        style = {"fontsize": 16, "color": TEXT, "parse_math": False}
        annotations.shrink(own.set_title(panel.heading, **style), width - 40)
    words = {"title": title, "subtitle": subtitle}
    annotations.draw_frame(figure, view, scale=scale, top=_TOP, bottom=_BOTTOM, **words)
    annotations.draw_legend(figure, drawn, 70 / total, {})
    save(figure, path, software=software)


class _Grid(NamedTuple):
    """How panels are arranged: their number, height [pixels] and pixels per metre."""

    columns: int
    rows: int
    height: int
    scale: float


def _grid(view: View, n: int) -> _Grid:
    """Arrange panels so that the body is as large as the page allows."""
    grids = []
    for columns in range(1, n + 1):
        rows = math.ceil(n / columns)
        scale = (_WIDTH // columns - 2 * _MARGIN) / view.width
        most = max(_LOWEST, min(_HIGHEST, _PAGE // rows))
        height = int(np.clip(view.height * scale + 2 * _MARGIN, _LOWEST, most))
        scale = min(scale, (height - 2 * _MARGIN) / view.height)
        grids.append(_Grid(columns, rows, height, scale))
    return max(grids, key=lambda grid: grid.scale)


def _panel(
    model: Model, c: Configuration, heading: str, records: tuple[EffectorRecord, ...]
) -> _Panel:
    """Collect what is drawn of a configuration."""
    robot = robots.robot_picture(model, _at_rest(model, c))
    points = [record for record in records if record.quantity == "point"]
    seen = [p.at_rest for p in points] + [p for p, _ in _measured(model, points)]
    places = [np.reshape(seen, (-1, 3)), robot.points]
    places.append(load_points(c, model.mesh, model.mesh.points))
    return _Panel(c, heading, tuple(points), robot, np.vstack(places))


def _measured(
    model: Model, points: Sequence[EffectorRecord]
) -> list[tuple[HostArray, HostArray]]:
    """Pair the places that were measured with those at rest, but for far ones [m]."""
    return [
        (np.where(p.seen, p.measured, p.at_rest), p.at_rest)
        for p in points
        if p.seen.any() and farthest(motions([p]), model.mesh.size) is None
    ]


def _at_rest(model: Model, c: Configuration) -> RobotState:
    """Describe the actuators of a configuration as they are imposed, undeformed."""
    actuators, states = model.mechanism.actuators, []
    every = zip(actuators.names, actuators.kinds, actuators.motor_body, strict=True)
    for name, kind, motor in every:
        asked = c.actuation.get(name)
        by_displacement = isinstance(asked, ImposedDisplacement)
        by_displacement |= asked is None and motor >= 0
        value = 0.0 if asked is None else asked.value
        states.append(
            ActuatorState(
                name=name,
                kind=kind.noun,
                imposed="displacement" if by_displacement else "force",
                force=math.nan if by_displacement else value,
                force_unit=kind.force_unit,
                displacement=value if by_displacement else None,
                displacement_unit=kind.displacement_unit,
            )
        )
    return RobotState((), tuple(states), (), np.zeros_like(model.mechanism.points))


def _draw_panel(
    axes: "matplotlib.axes.Axes", view: View, model: Model, panel: _Panel
) -> list[str]:
    """Draw one configuration; return what was drawn, for the legend."""
    c, mesh = panel.configuration, model.mesh
    _draw_bodies(axes, view, model, c)
    drawn = ["rigid body"] if model.mechanism.bodies.n_bodies else []
    drawn += draw_setup(axes, view, c, mesh, mesh.points)
    robots.draw_robot(axes, view, panel.robot)
    drawn += panel.robot.kinds
    frames = {e.name for e in c.effectors if isinstance(e, BodyFrame)}
    sensors = [
        SensorFrame(p.at_rest, np.eye(3)) for p in panel.records if p.name in frames
    ]
    drawn += robots.draw_sensors(axes, view, sensors)
    for place, rest in _measured(model, panel.records):
        ends = view.project(np.stack([rest, place]))
        axes.plot(*ends[1], path_effects=annotations.halo(5.0), **SYMBOLS["measured"])
        axes.plot(*ends.T, **SYMBOLS["distance"])
        drawn.append("measured")
    for p in panel.records:
        flat = view.project(p.at_rest)
        style = SYMBOLS["point at rest"]
        axes.plot(*flat, path_effects=annotations.halo(5.0), **style)
        if len(panel.records) <= _MOST_NAMES:
            annotations.draw_name(axes, p.name, flat, (9, 7), fontsize=13)
        drawn.append("point at rest")
    annotations.separate_names(axes)
    return drawn


def _draw_bodies(
    axes: "matplotlib.axes.Axes", view: View, model: Model, c: Configuration
) -> None:
    """Draw the nodes of rigid bodies as a patch, with name and state."""
    from matplotlib.collections import PolyCollection

    bodies, mesh = model.mechanism.bodies, model.mesh
    faces = boundary_faces(mesh)[:, :3]
    for k, name in enumerate(bodies.names):
        nodes = bodies.attached[bodies.body == k]
        own = faces[np.isin(faces, nodes).all(axis=1)]
        corners = list(view.project(mesh.points[own]))
        style = {"facecolor": RIGID, "edgecolor": FAINT, "lw": 0.6, "alpha": 0.75}
        axes.add_collection(PolyCollection(corners, **style))
        flat = view.project(mesh.points[nodes])
        if not len(own):
            axes.plot(*flat.T, "o", ms=4, color=FAINT)
        state = c.bodies.get(name)
        kind = state if isinstance(state, str) else getattr(state, "kind", "held")
        text = name if state is None else f"{name} ({kind})"
        place = (flat[:, 0].mean(), flat[:, 1].max())
        annotations.draw_name(axes, text, place, (0, 9), ha="center", fontsize=13)


def _fibre_directions(model: Model) -> Float[HostArray, "n_tets 3"] | None:
    """Return the direction of the first fibre in each tet, zero without stiffness [-].

    On the host, where nothing is compiled; None for a law without fibres.
    """
    is_fibre = lambda part: isinstance(part, Fibre)
    parts = jax.tree.leaves(model.law, is_leaf=is_fibre)
    fibres = [part for part in parts if is_fibre(part)]
    if not fibres:
        return None

    def per_tet(value: Any) -> HostArray:
        # Of several quadrature points, the first.
        values = np.asarray(getattr(value, "values", value))
        values = values[..., 0] if hasattr(value, "values") else values
        return np.broadcast_to(values, (model.mesh.n_tets,))

    fibre = fibres[0]
    theta, phi = per_tet(fibre.theta), per_tet(fibre.phi)
    a, b = ("xyz".index(letter) for letter in fibre.plane)
    own = np.zeros((model.mesh.n_tets, 3))
    own[:, a], own[:, b] = np.cos(phi) * np.cos(theta), np.cos(phi) * np.sin(theta)
    own[:, 3 - a - b] = np.sin(phi)
    if fibre.frame is not None:
        rows = np.stack([per_tet(part) for part in fibre.frame], axis=1)
        own = np.einsum("ei,eij->ej", own, rows.reshape(-1, 3, 3))
    stiffness = getattr(model.law, "E_f", None)
    return own if stiffness is None else own * (per_tet(stiffness) > 0.0)[:, None]


def _draw_fibres(
    axes: "matplotlib.axes.Axes",
    view: View,
    faces: VisibleFaces,
    fibres: Float[HostArray, "n_tets 3"],
) -> None:
    """Draw fibres of some of the tets whose outer face is seen."""
    from matplotlib.collections import LineCollection

    sides = faces.corners[:, 1:] - faces.corners[:, :1]
    areas = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    half = max(0.5 * np.sqrt(np.median(areas)), 0.008 * view.width)
    own = np.flatnonzero(np.any(fibres[faces.tet] != 0.0, axis=1))
    own = own[:: max(1, math.ceil(own.size / _MOST_FIBRES))]
    centres, along = faces.corners[own].mean(axis=1), half * fibres[faces.tet[own]]
    lines = view.project(np.stack([centres - along, centres + along], axis=1))
    axes.add_collection(LineCollection(list(lines), **SYMBOLS["fibre"], alpha=0.8))
