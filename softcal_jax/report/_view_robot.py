"""Cables, walls, motors, forces, loads and frames of a configuration, in mm."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from softcal_jax._text import escaped
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model
from softcal_jax.export import readable_values
from softcal_jax.mesh import TetMesh
from softcal_jax.plotting import (
    RobotPicture,
    actuator_words,
    is_seen,
    load_place,
    pushes,
    robot_picture,
    sensor_frames,
)


def robot_data(model: Model, own: ConfigurationResult) -> dict[str, Any]:
    """Collect what is drawn beside the soft body.

    Returns:
        `cables` (`name`, `slack`, `segments`), `walls`: corners of the faces under
        pressure, `wallNames` (`name`, `at`), `arrows` (`kind`, `name`, `tip`,
        `towards`), `motors` (`name`, `at`, `axis`), `frames` (`kind`, `name`, `at`,
        `axes`), `gravity`: its direction or None, and `reach`: points that must be in
        the view. Nothing but gravity without an equilibrium.
    """
    found: dict[str, Any] = {"walls": np.zeros((0, 3), int)}
    found |= {k: [] for k in ("cables", "wallNames", "arrows", "motors", "frames")}
    if own.converged and own.robot is not None:
        picture = robot_picture(model, own.robot)
        found |= _actuators(picture)
        found["frames"] += _bodies(model, picture)
    if own.converged:
        for frame in sensor_frames(own):
            kind = "measured" if frame.is_measured else "simulated"
            place = {"at": _mm(frame.position), "axes": frame.rotation.T.tolist()}
            found["frames"].append({"kind": kind, "name": "", **place})
    if own.converged and own.posed is not None:
        x = model.mesh.points + own.displacement
        found["arrows"] += _loads(own.posed, model.mesh, x)
    gravity = np.zeros(3) if own.posed is None else np.asarray(own.posed.gravity, float)
    size = np.linalg.norm(gravity)
    found["gravity"] = (gravity / size).tolist() if size > 0.0 else None
    ends = [end for c in found["cables"] for s in c["segments"] for end in s]
    tips = [part["tip"] for part in found["arrows"]]
    places = [part["at"] for part in (*found["motors"], *found["frames"])]
    found["reach"] = [*ends, *tips, *places]
    return found


def _actuators(picture: RobotPicture) -> dict[str, Any]:
    geometry = picture.geometry
    cables, names, arrows, motors, walls = [], [], [], [], [np.zeros((0, 3), int)]
    for a, actuator in enumerate(picture.state.actuators):
        if not is_seen(actuator):
            continue
        name = escaped(actuator_words(actuator))
        segments = geometry.segments[geometry.segment_owner == a]
        if len(segments):
            slack = actuator.kind == "cable" and actuator.force == 0.0
            ends = [[_mm(end) for end in segment] for segment in segments]
            cables.append({"name": name, "slack": slack, "segments": ends})
        faces = geometry.faces[geometry.face_owner == a, :3]
        if len(faces):
            walls.append(faces)
            names.append({"name": name, "at": _mm(picture.x[faces].mean(axis=(0, 1)))})
        for k in np.flatnonzero(geometry.point_owner == a)[:1]:
            place, along = _mm(geometry.points[k]), geometry.arrows[k]
            if actuator.kind == "motor":
                motors.append({"name": name, "at": place, "axis": along.tolist()})
            else:
                towards = (pushes(actuator) * along).tolist()
                arrows.append(_arrow("force", name, place, towards))
    joined = {"cables": cables, "walls": np.concatenate(walls), "wallNames": names}
    return {**joined, "arrows": arrows, "motors": motors}


def _arrow(
    kind: str, name: str, tip: list[float], towards: list[float]
) -> dict[str, Any]:
    return {"kind": kind, "name": name, "tip": tip, "towards": towards}


def _bodies(model: Model, picture: RobotPicture) -> Iterator[dict[str, Any]]:
    """Yield the frames of rigid bodies."""
    frames = picture.x[model.mesh.n_nodes :].reshape(-1, 4, 3)
    axes = (frames[:, 1:] - frames[:, :1]) / model.mechanism.bodies.length
    for body, x, a in zip(picture.state.bodies, frames[:, 0], axes, strict=True):
        place = {"at": _mm(x), "axes": a.tolist()}
        yield {"kind": "frame", "name": escaped(body.name), **place}


def _loads(
    posed: Configuration, mesh: TetMesh, x: Float[HostArray, "n_nodes 3"]
) -> Iterator[dict[str, Any]]:
    """Yield the dead loads, each at the mean place where it acts."""
    for load in posed.loads:
        place, force = load_place(load, mesh, x)
        size = float(np.linalg.norm(force))
        if size > 0.0:
            name = readable_values([size], "N", digits=3)
            yield _arrow("load", name, _mm(place), (force / size).tolist())


def _mm(x: Float[HostArray, "3"]) -> list[float]:
    return np.round(1e3 * x, 3).tolist()
