"""What acts on a body or stands beside it, and the sensors on it, over its picture."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax._units import readable_values
from softcal_jax.actuators import actuator_geometry
from softcal_jax.bodies import BodyStateArrays
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.configurations import AbstractLoad, Configuration, Support
from softcal_jax.contact import HalfSpace
from softcal_jax.equilibrium import ActuatorState, Model, RobotState
from softcal_jax.mesh import TetMesh, node_indices
from softcal_jax.plotting import _figure as figures
from softcal_jax.plotting._figure import Axes, in_points, symbol
from softcal_jax.plotting._view import View

if TYPE_CHECKING:
    import pyvista

_UNSEEN_AT_REST = ("force actuator", "surface force actuator", "surface pressure")
"""Actuators that are not drawn where they do not push."""


class DrawnActuator(NamedTuple):
    """An actuator in a picture; what it does not have is empty.

    Attributes:
        kind: A noun like "cable".
        name: Its name, and what drives it.
        slack: Whether it is a cable without tension.
        segments: Ends of the segments of a cable [m].
        faces: Corners of the faces that are under its pressure.
        points: The place where its force acts, or of a motor [m].
        arrows: Direction of that force, or axis of that motor [-].
    """

    kind: str
    name: str
    slack: bool
    segments: Float[HostArray, "n_segments 2 3"]
    faces: Int[HostArray, "n_faces 3"]
    points: Float[HostArray, "n_points 3"]
    arrows: Float[HostArray, "n_points 3"]


class SensorFrame(NamedTuple):
    """Measured or simulated place of a 6-D sensor [m], and rotation from rest [-]."""

    position: Float[HostArray, "3"]
    rotation: Float[HostArray, "3 3"]
    is_measured: bool = False


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


class RobotPicture(NamedTuple):
    """What is drawn on a body and beside it, in one configuration.

    Attributes:
        model: The model.
        x: Positions of the nodes of mesh and body frames [m].
        points: What must be visible in addition to the body [m].
        actuators: Those that are drawn.
        loads: Of each dead load, the mean place where it acts [m], and its sum [N].
        posed: The configuration, for its supports and gravity, if it is known.
        sensors: Places of 6-D sensors.
        obstacles: Those that are there.
        pressure: Of contact, on each face of the boundary [Pa].
    """

    model: Model
    x: Float[HostArray, "n_points 3"]
    points: Float[HostArray, "n 3"]
    actuators: Sequence[DrawnActuator]
    loads: Sequence[tuple[Float[HostArray, "3"], Float[HostArray, "3"]]]
    posed: Configuration | None
    sensors: Sequence[SensorFrame]
    obstacles: Sequence[PlacedObstacle]
    pressure: Float[HostArray, " n_faces"]


def robot_picture(model: Model, result: ConfigurationResult) -> RobotPicture:
    """Collect what is drawn of a configuration in equilibrium."""
    # Without rigid bodies and actuators, there is no state of them.
    state = result.robot or RobotState((), (), (), (), result.displacement)
    beside = _sensor_frames(result), _obstacles_at(model, state)
    return picture_of(model, state, result.posed, *beside)


def picture_of(
    model: Model,
    state: RobotState,
    posed: Configuration | None,
    sensors: Sequence[SensorFrame],
    obstacles: Sequence[PlacedObstacle],
) -> RobotPicture:
    """Collect what is drawn of a state; sensors and obstacles are known already."""
    x = np.asarray(model.mechanism.points) + state.displacement
    loads = () if posed is None else posed.loads
    placed = [_load_place(load, model.mesh, x[: model.mesh.n_nodes]) for load in loads]
    shape = actuator_geometry(model.mechanism.actuators, x)
    actuators = []
    for a, actuator in enumerate(state.actuators):
        if actuator.kind in _UNSEEN_AT_REST and actuator.force == 0.0:
            continue
        known = not np.isnan(actuator.force)
        imposed = actuator.force if known else actuator.displacement
        # A motor has an axis; a force acts one way along its direction or the other.
        way = 1.0 if actuator.kind == "motor" else float(np.sign(imposed or 1.0))
        k = np.flatnonzero(shape.point_owner == a)[:1]
        drawn = DrawnActuator(
            kind=actuator.kind,
            name=_words(actuator),
            slack=actuator.kind == "cable" and actuator.force == 0.0,
            segments=shape.segments[shape.segment_owner == a],
            faces=shape.faces[shape.face_owner == a, :3],
            points=shape.points[k],
            arrows=way * shape.arrows[k],
        )
        actuators.append(drawn)
    points = [shape.segments.reshape(-1, 3), shape.points, *(p for p, _ in placed)]
    parts = actuators, placed, posed, sensors, obstacles, state.surface_pressure(model)
    return RobotPicture(model, x, np.vstack(points), *parts)


def _words(actuator: ActuatorState) -> str:
    """Write an actuator's name and what drives it; before a solve, what is imposed."""
    words = [readable_values([actuator.force], actuator.force_unit, digits=3)]
    value, unit = actuator.displacement, actuator.displacement_unit
    if actuator.kind == "cable" and actuator.force == 0.0:
        words = ["slack"]
    elif value is not None and unit is not None:
        displacement = readable_values([value], unit, digits=3)
        if np.isnan(actuator.force):
            words = [displacement]
        elif actuator.kind == "motor" and np.isfinite(value):
            words = [displacement, *words]
    return f"{actuator.name}: {', '.join(words)}"


def _load_place(
    load: AbstractLoad, mesh: TetMesh, x: Float[HostArray, "n_nodes 3"]
) -> tuple[Float[HostArray, "3"], Float[HostArray, "3"]]:
    """Find the mean place where a load acts [m], with nodes at x, and its sum [N]."""
    forces = load.nodal_forces(mesh)
    # Nodes of quadratic faces share a force unevenly, with some shares of zero.
    weights = np.abs(forces @ forces.sum(axis=0))
    if not weights.any():
        weights = np.linalg.norm(forces, axis=1)
    if not weights.any():
        weights = np.ones(mesh.n_nodes)
    return np.average(x, axis=0, weights=weights), forces.sum(axis=0)


def _sensor_frames(result: ConfigurationResult) -> list[SensorFrame]:
    """List measured and simulated poses of 6-D sensors, as far as they are known."""
    points = {point.name: point for point in result.points}
    frames = []
    for turn in result.turns:
        if turn.name not in points:
            continue
        point, R = points[turn.name], turn.reference
        if turn.seen.any():
            frames.append(SensorFrame(point.measured, R, True))
        simulated = Rotation.from_rotvec(turn.simulated).as_matrix() @ R
        frames.append(SensorFrame(point.simulated, simulated))
    known = lambda frame: np.isfinite([*frame.position, *frame.rotation.flat]).all()
    return [frame for frame in frames if known(frame)]


def _obstacles_at(model: Model, state: RobotState) -> list[PlacedObstacle]:
    """List the obstacles that are there at an equilibrium, with the forces on them."""
    contacts = model.mechanism.contacts
    x = np.asarray(model.mechanism.points) + state.displacement
    felt = {contact.name: contact for contact in state.contacts}
    names = list(contacts.names)
    for k, name in enumerate(contacts.names):
        if name in felt and felt[name].area != 0.0:
            size = float(np.linalg.norm(felt[name].force))
            names[k] = f"{name}: {readable_values([size], 'N', digits=3)}"
    present = np.array([name in felt for name in contacts.names], bool)
    return _placed(model, present, x[contacts.frames], names)


def obstacles_at_start(model: Model, states: BodyStateArrays) -> list[PlacedObstacle]:
    """List the obstacles that are there before the load, in states of the bodies."""
    if model.mechanism.contacts.n_obstacles == 0:
        return []  # without compiling for it
    standing = jax.device_get(model.mechanism.standing(states))
    names = model.mechanism.contacts.names
    return _placed(model, standing.present, standing.start, names)


def _placed(
    model: Model,
    present: Bool[HostArray, " n_obstacles"],
    frames: Float[HostArray, "n_obstacles 4 3"],
    names: Sequence[str],
) -> list[PlacedObstacle]:
    contacts, middle = model.mechanism.contacts, model.mesh.points.mean(axis=0)
    obstacles = []
    for k in np.flatnonzero(present).tolist():
        origin = frames[k, 0]
        axes = (frames[k, 1:] - origin) / contacts.length
        if isinstance(contacts.shapes[k], HalfSpace):
            # Its plate lies beside the body, wherever in the plane its origin is.
            origin = middle - axes[2] * (axes[2] @ (middle - origin))
        obstacles.append(PlacedObstacle(k, names[k], origin, axes))
    return obstacles


_MOST = 2500  # triangles of a surface; more of them look the same
_COVER = 0.35  # opacity of an obstacle in a plan


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


def draw_obstacles(axes: Axes, view: View, picture: RobotPicture) -> None:
    """Draw obstacles by what is seen of their surfaces, behind or before the body."""
    depth = picture.model.mesh.points.mean(axis=0) @ view.towards
    for surface in placed_surfaces(picture.model, picture.obstacles):
        corners = _seen(np.asarray(surface.points)[surface.regular_faces], view)
        behind = corners.mean(axis=(0, 1)) @ view.towards < depth
        style = {"facecolor": figures.OBSTACLE, "edgecolor": "none", "alpha": _COVER}
        figures.draw_patch(axes, view, corners, **style, zorder=0.5 if behind else 1.5)
    name_obstacles(axes, view, picture)


def _seen(corners: Float[HostArray, "n 3 3"], view: View) -> Float[HostArray, "m 3 3"]:
    """Take the triangles on the side of the viewer, or all of what has one side."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middles = corners.mean(axis=1)
    outwards = np.sum(normals * (middles - middles.mean(axis=0)))
    towards = normals @ view.towards * np.sign(outwards or 1.0)
    return corners[towards > 0.0] if (towards > 0.0).any() else corners


def name_obstacles(axes: Axes, view: View, picture: RobotPicture) -> None:
    """Write the name of each obstacle where it is farthest from the body."""
    half = 0.9 * np.array([axes.get_xlim()[1], axes.get_ylim()[1]])
    body = view.project(picture.model.mesh.points)
    surfaces = placed_surfaces(picture.model, picture.obstacles)
    for obstacle, surface in zip(picture.obstacles, surfaces, strict=True):
        flat = view.project(np.asarray(surface.points))
        inside = np.all(np.abs(flat) <= half, axis=1)
        inside &= np.any(flat < 0.55 * half, axis=1)  # gravity is in that corner
        flat = flat[inside] if inside.any() else np.clip(flat, -half, half)
        place = flat[np.argmax(cdist(flat, body).min(axis=1))]
        style = {"ha": "center", "va": "center", "fontsize": "small"}
        figures.draw_name(
            axes, obstacle.name, place, (0, 0), **style, color=figures.FAINT
        )


_FRAME, _AXIS, _ARROW = 0.05, 0.08, 0.1  # sensors, hinges, forces; of the view's width
_SHORTEST, _LONGEST = 0.07, 0.14  # arrows of loads, over the width of the view
_GRAVITY = 0.05  # length of its arrow, over the width of the picture
_LEAST = 0.15  # an arrow of which less of the length is seen is drawn end on [-]


def draw_robot(axes: Axes, view: View, picture: RobotPicture) -> set[str]:
    """Draw supports, loads, gravity, actuators and sensors; return what was drawn.

    Each has its name or its size. The axes are in metres, around the centre of the
    view.
    """
    drawn = set()
    if picture.posed is not None:
        for support in picture.posed.supports:
            _draw_support(axes, view, support, picture.model.mesh, picture.x)
            drawn.add("support")
        drawn |= _draw_loads(axes, view, picture.posed, picture.loads)
    for actuator in picture.actuators:
        drawn |= _draw_actuator(axes, view, actuator, picture.x)
    for frame in picture.sensors:
        style = symbol("sensor's axes", solid_capstyle="round")
        if frame.is_measured:
            style["color"] = figures.MEASURED
        for axis in frame.rotation.T:
            tip = frame.position + _FRAME * view.width * axis
            ends = view.project(np.stack([frame.position, tip]))
            axes.plot(*ends.T, path_effects=figures.halo(4.0), **style)
        drawn.add("sensor's axes")
    return drawn


def _draw_actuator(
    axes: Axes, view: View, actuator: DrawnActuator, x: Float[HostArray, "n_points 3"]
) -> set[str]:
    drawn, places, rim = set(), [], figures.halo(5.0)
    if len(actuator.faces):
        drawn.add("wall under pressure")
        corners = x[actuator.faces]
        style = {"facecolor": figures.WALL, "edgecolor": "white", "alpha": 0.3}
        figures.draw_patch(axes, view, corners, **style)
        places.append(view.project(corners).mean(axis=(0, 1)))
    if len(actuator.segments):
        drawn.add("cable")
        style = symbol("cable", ls=":" if actuator.slack else "-", marker="o", ms=6.0)
        segments = actuator.segments
        for ends in view.project(segments):
            axes.plot(*ends.T, **style, path_effects=rim)
        lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
        places.append(view.project(segments[np.argmax(lengths)].mean(axis=0)))
    for point, arrow in zip(actuator.points, actuator.arrows, strict=True):
        if actuator.kind == "motor":
            drawn.add("motor")
            half = _AXIS * view.width * arrow
            ends = view.project(np.stack([point - half, point + half]))
            axes.plot(*ends.T, **symbol("motor", marker=""), path_effects=rim)
            places.append(view.project(point))
            axes.plot(*places[-1], "o", color=figures.MOTOR, ms=in_points(9.0))
        else:
            drawn.add("force")
            # The arrow ends where the force acts.
            places.append(view.project(point - _ARROW * view.width * arrow))
            figures.draw_arrow(axes, places[-1], view.project(point), figures.FORCE)
    for place in places[:1]:
        figures.draw_name(axes, actuator.name, place, (0, 12), ha="center")
    return drawn


def _draw_loads(
    axes: Axes,
    view: View,
    posed: Configuration,
    loads: Sequence[tuple[Float[HostArray, "3"], Float[HostArray, "3"]]],
) -> set[str]:
    """Draw dead loads and gravity."""
    drawn = set()
    sizes = [float(np.linalg.norm(force)) for _, force in loads]
    for load, (place, force), size in zip(posed.loads, loads, sizes, strict=True):
        if size > 0.0:
            drawn.add("load")
            share = _SHORTEST + (_LONGEST - _SHORTEST) * size / max(sizes)
            text = readable_values([size], "N", digits=3)
            named = getattr(load, "where", None)
            name = f"{text} on {named}" if isinstance(named, str) else text
            along = view.width * share * force / size
            _draw_arrow(axes, view, place, along, figures.FORCE, name)
    g = np.asarray(posed.gravity, float)
    size = float(np.linalg.norm(g))
    corner = np.array([axes.get_xlim()[1], axes.get_ylim()[1]])
    if size == 0.0:
        style = {"fontsize": "small", "color": figures.GRAVITY, "ha": "right"}
        figures.draw_name(axes, "no gravity", 0.95 * corner, (0, 0), **style)
        return drawn
    # In the upper right corner, with its middle at the same place always.
    half = _GRAVITY * corner[0] * g / size
    x, y = corner * (0.87, 0.8)
    place = view.centre + x * view.right + y * view.up - half
    _draw_arrow(axes, view, place, 2.0 * half, figures.GRAVITY, f"{size:.4g} m/s2")
    return drawn | {"gravity"}


def _draw_support(
    axes: Axes,
    view: View,
    support: Support,
    mesh: TetMesh,
    x: Float[HostArray, "n_points 3"],
) -> None:
    """Draw the held faces as a patch, or the held nodes as squares."""
    nodes = node_indices(mesh, support.where, "a support")
    name, places = support.name, view.project(x[nodes])
    if name in mesh.surface_groups:
        style = {"facecolor": figures.SUPPORT, "edgecolor": "white", "alpha": 0.4}
        figures.draw_patch(axes, view, x[mesh.faces(name)[:, :3]], **style)
    else:
        axes.plot(*places.T, **symbol("support", ms=5.0))
    text = name if support.axes == "xyz" else f"{name}: {support.axes} held"
    if support.stiffness is not None:
        text += ", elastic"
    if np.any(support.displacement):
        text += f", moved by {readable_values(support.displacement, 'm', digits=3)}"
    lowest = places[:, 0].mean(), places[:, 1].min()
    style = {"ha": "center", "va": "top", "fontsize": "small"}
    figures.draw_name(axes, text, lowest, (0, -8), **style, color=figures.SUPPORT)


def _draw_arrow(
    axes: Axes,
    view: View,
    place: Float[HostArray, "3"],
    along: Float[HostArray, "3"],
    colour: str,
    text: str,
) -> None:
    """Draw an arrow from where a force acts, along a vector of its length [m]."""
    start = view.project(place)
    step = np.array([along @ view.right, along @ view.up])
    if np.linalg.norm(step) < _LEAST * np.linalg.norm(along):
        ring = {"ms": in_points(13.0), "mec": colour, "mew": in_points(2.5)}
        axes.plot(*start, "o", mfc="none", **ring)
        mark = "." if along @ view.towards > 0 else "x"
        axes.plot(*start, mark, ms=in_points(8.0), color=colour)
        figures.draw_name(axes, text, start, (12, 8), fontsize="small", color=colour)
        return
    end = start + step
    figures.draw_arrow(axes, start, end, colour)
    # Towards the middle of the picture, where there is room.
    left = start[0] > 0.0
    side = {"ha": "right" if left else "left", "va": "center", "fontsize": "small"}
    where = (-9 if left else 9, 0)
    figures.draw_name(axes, text, 0.5 * (start + end), where, color=colour, **side)
