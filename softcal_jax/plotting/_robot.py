"""Draw cables, chambers, motors, forces and 6-D sensors over the picture of a body."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray
from softcal_jax.actuators import ActuatorGeometry, actuator_geometry
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.equilibrium import ActuatorState, Model, RobotState
from softcal_jax.export import readable_values
from softcal_jax.plotting._annotations import draw_name, halo
from softcal_jax.plotting._colours import FORCE, MEASURED, MOTOR, SYMBOLS, WALL
from softcal_jax.plotting._view import View

if TYPE_CHECKING:
    import matplotlib.axes

_FRAME, _AXIS, _ARROW = 0.05, 0.08, 0.1
"""Lengths of sensor axes, hinges and forces, relative to the width of the view."""

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

    @property
    def kinds(self) -> list[str]:
        """Entries of the legend."""
        actuators = self.state.actuators
        driven = [actuators[a] for a in self.geometry.point_owner]
        walls = [actuators[a] for a in np.unique(self.geometry.face_owner)]
        present = {
            "cable": len(self.geometry.segments) > 0,
            "wall under pressure": any(is_seen(a) for a in walls),
            "motor": any(a.kind == "motor" for a in driven),
            "force": any(a.kind != "motor" and is_seen(a) for a in driven),
        }
        return [kind for kind, is_present in present.items() if is_present]


def robot_picture(model: Model, state: RobotState) -> RobotPicture:
    """Collect what is drawn beside the soft body."""
    x = np.asarray(model.mechanism.points) + state.displacement
    geometry = actuator_geometry(model.mechanism.actuators, x)
    return RobotPicture(geometry, state, x)


def draw_robot(axes: "matplotlib.axes.Axes", view: View, picture: RobotPicture) -> None:
    """Draw the actuators, each with its name and force."""
    geometry, actuators = picture.geometry, picture.state.actuators
    for a, actuator in enumerate(actuators):
        if not is_seen(actuator):
            continue
        places = [
            _draw_wall(axes, view, picture, a),
            _draw_cable(axes, view, geometry, a, slack=actuator.force == 0.0),
            _draw_point(axes, view, picture, a),
        ]
        place = next((p for p in places if p is not None), None)
        if place is not None:
            draw_name(axes, actuator_words(actuator), place, (0, 12), ha="center")


def is_seen(actuator: ActuatorState) -> bool:
    """Say whether an actuator is drawn: forces and surface pressures only if not 0."""
    return actuator.kind not in _UNSEEN_AT_REST or actuator.force != 0.0


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


def _draw_cable(axes, view: View, geometry: ActuatorGeometry, a: int, *, slack: bool):
    segments = geometry.segments[geometry.segment_owner == a]
    if not len(segments):
        return None
    style = {**SYMBOLS["cable"], "ls": ":" if slack else "-", "marker": "o", "ms": 6}
    for ends in view.project(segments):
        axes.plot(*ends.T, **style, path_effects=halo(5.0))
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    return view.project(segments[np.argmax(lengths)].mean(axis=0))


def _draw_wall(axes, view: View, picture: RobotPicture, a: int):
    from matplotlib.collections import PolyCollection

    faces = picture.geometry.faces[picture.geometry.face_owner == a, :3]
    if not len(faces):
        return None
    flat = view.project(picture.x[faces])
    style = {"facecolor": WALL, "edgecolor": "white", "lw": 0.4, "alpha": 0.3}
    axes.add_collection(PolyCollection(list(flat), **style))
    return flat.mean(axis=(0, 1))


def _draw_point(axes, view: View, picture: RobotPicture, a: int):
    geometry, actuator = picture.geometry, picture.state.actuators[a]
    if a not in geometry.point_owner:
        return None
    k = np.argmax(geometry.point_owner == a)
    point, arrow = geometry.points[k], geometry.arrows[k]
    if actuator.kind == "motor":
        half = _AXIS * view.width * arrow
        ends = view.project(np.stack([point - half, point + half]))
        style = {k: v for k, v in SYMBOLS["motor"].items() if k != "marker"}
        axes.plot(*ends.T, **style, path_effects=halo(5.0))
        axes.plot(*view.project(point), "o", color=MOTOR, ms=9)
        return view.project(point)
    # The arrow ends where the force acts.
    tail = point - pushes(actuator) * _ARROW * view.width * arrow
    ends = view.project(np.stack([tail, point]))
    look = {"arrowstyle": "-|>", "color": FORCE, "lw": 3.0, "mutation_scale": 22}
    axes.annotate("", ends[1], ends[0], arrowprops={**look, "shrinkB": 0})
    return ends[0]


def pushes(actuator: ActuatorState) -> float:
    """Say which way a force actuator acts along its direction: 1 or -1."""
    imposed = actuator.displacement if np.isnan(actuator.force) else actuator.force
    return float(np.sign(imposed or 1.0))


def draw_sensors(
    axes: "matplotlib.axes.Axes", view: View, frames: Sequence[SensorFrame]
) -> list[str]:
    """Draw the axes of 6-D sensors; return what was drawn, for the legend."""
    for frame in frames:
        style = {**SYMBOLS["sensor's axes"], "solid_capstyle": "round"}
        if frame.is_measured:
            style["color"] = MEASURED
        for axis in frame.rotation.T:
            tip = frame.position + _FRAME * view.width * axis
            ends = view.project(np.stack([frame.position, tip]))
            axes.plot(*ends.T, path_effects=halo(4.0), **style)
    return ["sensor's axes"] if frames else []
