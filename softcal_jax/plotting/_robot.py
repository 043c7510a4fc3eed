"""Draw what acts on a body, and the sensors on it, over its picture."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable_values
from softcal_jax.actuators import ActuatorGeometry, actuator_geometry
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.configurations import AbstractLoad, Configuration, Support
from softcal_jax.equilibrium import ActuatorState, Model, RobotState
from softcal_jax.mesh import TetMesh, node_indices
from softcal_jax.plotting._figure import (
    FORCE,
    GRAVITY,
    MEASURED,
    MOTOR,
    SUPPORT,
    WALL,
    Axes,
    draw_arrow,
    draw_name,
    draw_patch,
    halo,
    in_points,
    symbol,
)
from softcal_jax.plotting._view import View

_FRAME, _AXIS, _ARROW = 0.05, 0.08, 0.1  # sensors, hinges, forces; of the view's width
_UNSEEN_AT_REST = ("force actuator", "surface force actuator", "surface pressure")
"""Actuators that are not drawn where they do not push."""


class SensorFrame(NamedTuple):
    """Measured or simulated place of a 6-D sensor [m], and rotation from rest [-]."""

    position: Float[HostArray, "3"]
    rotation: Float[HostArray, "3 3"]
    is_measured: bool = False


def sensor_frames(result: ConfigurationResult) -> list[SensorFrame]:
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


class RobotPicture(NamedTuple):
    """Actuators and their forces, drawn beside the soft body; nodes are at x [m]."""

    geometry: ActuatorGeometry
    state: RobotState
    x: Float[HostArray, "n_points 3"]

    @property
    def points(self) -> Float[HostArray, "n 3"]:
        """Points that must be visible in addition to the body [m]."""
        return np.vstack([self.geometry.segments.reshape(-1, 3), self.geometry.points])

    def parts(self) -> Iterator[tuple[ActuatorState, *tuple[HostArray, ...]]]:
        """Yield actuators that are drawn: segments, faces, first point and its arrow.

        Each of these is empty where an actuator has none.
        """
        shape = self.geometry
        for a, actuator in enumerate(self.state.actuators):
            if actuator.kind not in _UNSEEN_AT_REST or actuator.force != 0.0:
                k = np.flatnonzero(shape.point_owner == a)[:1]
                segments = shape.segments[shape.segment_owner == a]
                faces = shape.faces[shape.face_owner == a, :3]
                yield actuator, segments, faces, shape.points[k], shape.arrows[k]


def robot_picture(model: Model, state: RobotState) -> RobotPicture:
    """Collect what is drawn beside the soft body."""
    x = np.asarray(model.mechanism.points) + state.displacement
    geometry = actuator_geometry(model.mechanism.actuators, x)
    return RobotPicture(geometry, state, x)


def draw_robot(axes: Axes, view: View, picture: RobotPicture) -> set[str]:
    """Draw actuators, each with its name and force; return what was drawn."""
    drawn = set()
    for actuator, segments, faces, points, arrows in picture.parts():
        places = []
        if len(faces):
            drawn.add("wall under pressure")
            style = {"facecolor": WALL, "edgecolor": "white", "alpha": 0.3}
            draw_patch(axes, view, picture.x[faces], **style)
            places.append(view.project(picture.x[faces]).mean(axis=(0, 1)))
        if len(segments):
            drawn.add("cable")
            slack = actuator.force == 0.0
            places.append(_draw_cable(axes, view, segments, slack=slack))
        if len(points):
            drawn.add("motor" if actuator.kind == "motor" else "force")
            places.append(_draw_point(axes, view, actuator, points[0], arrows[0]))
        if places:
            draw_name(axes, actuator_words(actuator), places[0], (0, 12), ha="center")
    return drawn


def actuator_words(actuator: ActuatorState) -> str:
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


def _draw_cable(axes, view: View, segments: Float[HostArray, "n 2 3"], *, slack: bool):
    style = symbol("cable", ls=":" if slack else "-", marker="o", ms=6.0)
    for ends in view.project(segments):
        axes.plot(*ends.T, **style, path_effects=halo(5.0))
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    return view.project(segments[np.argmax(lengths)].mean(axis=0))


def _draw_point(axes, view: View, actuator: ActuatorState, point, arrow):
    if actuator.kind == "motor":
        half = _AXIS * view.width * arrow
        ends = view.project(np.stack([point - half, point + half]))
        style = symbol("motor", marker="")
        axes.plot(*ends.T, **style, path_effects=halo(5.0))
        axes.plot(*view.project(point), "o", color=MOTOR, ms=in_points(9.0))
        return view.project(point)
    # The arrow ends where the force acts.
    tail = point - pushes(actuator) * _ARROW * view.width * arrow
    draw_arrow(axes, view.project(tail), view.project(point), FORCE)
    return view.project(tail)


def pushes(actuator: ActuatorState) -> float:
    """Say which way a force actuator acts along its direction: 1 or -1."""
    imposed = actuator.displacement if np.isnan(actuator.force) else actuator.force
    return float(np.sign(imposed or 1.0))


def draw_sensors(axes: Axes, view: View, frames: Sequence[SensorFrame]) -> list[str]:
    """Draw the axes of 6-D sensors; return what was drawn, for the legend."""
    for frame in frames:
        style = symbol("sensor's axes", solid_capstyle="round")
        if frame.is_measured:
            style["color"] = MEASURED
        for axis in frame.rotation.T:
            tip = frame.position + _FRAME * view.width * axis
            ends = view.project(np.stack([frame.position, tip]))
            axes.plot(*ends.T, path_effects=halo(4.0), **style)
    return ["sensor's axes"] if frames else []


_SHORTEST, _LONGEST = 0.07, 0.14  # arrows of loads, over the width of the view
_GRAVITY = 0.05  # length of its arrow, over the width of the picture
_LEAST = 0.15  # an arrow of which less of the length is seen is drawn end on [-]


def load_place(
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


def draw_setup(
    axes: Axes,
    view: View,
    configuration: Configuration,
    mesh: TetMesh,
    x: Float[HostArray, "n_nodes 3"],
) -> list[str]:
    """Draw supports, dead loads and gravity, each with its name or size.

    The axes are in metres, around the centre of the view; x are positions of the nodes
    in the picture [m]. Returns what was drawn, for the legend.
    """
    for support in configuration.supports:
        _draw_support(axes, view, support, mesh, x)
    placed = [load_place(load, mesh, x) for load in configuration.loads]
    sizes = [float(np.linalg.norm(force)) for _, force in placed]
    every = zip(configuration.loads, placed, sizes, strict=True)
    for load, (place, force), size in every:
        if size > 0.0:
            share = _SHORTEST + (_LONGEST - _SHORTEST) * size / max(sizes)
            text = readable_values([size], "N", digits=3)
            named = getattr(load, "where", None)
            name = f"{text} on {named}" if isinstance(named, str) else text
            along = view.width * share * force / size
            _draw_arrow(axes, view, place, along, FORCE, name)
    g = np.asarray(configuration.gravity, float)
    size = float(np.linalg.norm(g))
    corner = np.array([axes.get_xlim()[1], axes.get_ylim()[1]])
    if size > 0.0:
        # In the upper right corner, with its middle at the same place always.
        half = _GRAVITY * corner[0] * g / size
        x, y = corner * (0.87, 0.8)
        place = view.centre + x * view.right + y * view.up - half
        _draw_arrow(axes, view, place, 2.0 * half, GRAVITY, f"{size:.4g} m/s2")
    else:
        style = {"fontsize": "small", "color": GRAVITY, "ha": "right"}
        draw_name(axes, "no gravity", 0.95 * corner, (0, 0), **style)
    drawn = ["support"] if configuration.supports else []
    drawn += ["load"] if any(sizes) else []
    return drawn + (["gravity"] if size > 0.0 else [])


def _draw_support(
    axes: Axes,
    view: View,
    support: Support,
    mesh: TetMesh,
    x: Float[HostArray, "n_nodes 3"],
) -> None:
    """Draw the held faces as a patch, or the held nodes as squares."""
    nodes = node_indices(mesh, support.where, "a support")
    name = support.name
    if name in mesh.surface_groups:
        style = {"facecolor": SUPPORT, "edgecolor": "white", "alpha": 0.4}
        draw_patch(axes, view, x[mesh.faces(name)[:, :3]], **style)
    else:
        axes.plot(*view.project(x[nodes]).T, **symbol("support", ms=5.0))
    text = name if support.axes == "xyz" else f"{name}: {support.axes} held"
    if support.stiffness is not None:
        text += ", elastic"
    if np.any(support.displacement):
        text += f", moved by {readable_values(support.displacement, 'm', digits=3)}"
    places = view.project(x[nodes])
    lowest = places[np.argmin(places[:, 1])]
    style = {"ha": "center", "va": "top", "fontsize": "small", "color": SUPPORT}
    draw_name(axes, text, (places[:, 0].mean(), lowest[1]), (0, -8), **style)


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
        draw_name(axes, text, start, (12, 8), fontsize="small", color=colour)
        return
    end = start + step
    draw_arrow(axes, start, end, colour)
    # Towards the middle of the picture, where there is room.
    left = start[0] > 0.0
    side = {"ha": "right" if left else "left", "va": "center", "fontsize": "small"}
    where = (-9 if left else 9, 0)
    draw_name(axes, text, 0.5 * (start + end), where, color=colour, **side)
