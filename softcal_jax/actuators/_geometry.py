"""Where actuators are, to draw them: segments of cables, walls, points and axes."""

from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.actuators._arrays import ActuatorArrays
from softcal_jax.actuators._cable import CableSegments
from softcal_jax.actuators._chamber import ChamberFaces
from softcal_jax.actuators._forces import WeightedNodes
from softcal_jax.actuators._motor import MotorFrames
from softcal_jax.actuators._pressure import PressureFaces


class ActuatorGeometry(NamedTuple):
    """Actuators as lines, faces and points, each with the number of its actuator.

    Attributes:
        segments: Ends of the segments of cables whose length can change [m].
        segment_owner: Their cables.
        faces: Nodes of the faces of chambers and surface pressures.
        face_owner: Their actuators.
        points: Where a force acts, its mean where it is spread, or the origin of the
            frame that a motor turns [m].
        arrows: Direction of a force, or the axis of a motor [-].
        point_owner: Their actuators.
    """

    segments: Float[HostArray, "n_segments 2 3"]
    segment_owner: Int[HostArray, " n_segments"]
    faces: Int[HostArray, "n_faces n_fn"]
    face_owner: Int[HostArray, " n_faces"]
    points: Float[HostArray, "n_markers 3"]
    arrows: Float[HostArray, "n_markers 3"]
    point_owner: Int[HostArray, " n_markers"]


def actuator_geometry(
    arrays: ActuatorArrays, x: Float[HostArray, "n_all 3"]
) -> ActuatorGeometry:
    """Where the actuators are.

    Args:
        arrays: The actuators.
        x: Positions of the mesh's nodes and the frame nodes [m].
    """
    segments, segment_owner = [np.zeros((0, 2, 3))], [np.zeros(0, int)]
    faces, face_owner = [], [np.zeros(0, int)]
    points, arrows, point_owner = [np.zeros((0, 3))], [np.zeros((0, 3))], []
    for group in arrays.groups:
        nodes, owner = np.asarray(group.nodes), np.asarray(group.owner)
        if isinstance(group, CableSegments):
            weights, fixed = np.asarray(group.weights), np.asarray(group.fixed)
            segments.append(np.einsum("cem,cmi->cei", weights, x[nodes]) + fixed)
            segment_owner.append(owner)
        elif isinstance(group, (ChamberFaces, PressureFaces)):
            faces.append(nodes)
            face_owner.append(owner)
        elif isinstance(group, MotorFrames):
            points.append(x[nodes[:, 0]])
            arrows.append(_unit(x[nodes[:, 3]] - x[nodes[:, 0]]))
            point_owner += owner.tolist()
        elif isinstance(group, WeightedNodes):
            weights = np.asarray(group.weights)[:, 0]
            for a in np.unique(owner):
                own, at = weights[owner == a], x[nodes[owner == a, 0]]
                direction = _unit(own.sum(axis=0)[None])
                points.append((own @ direction[0])[None] @ at)
                arrows.append(direction)
                point_owner.append(int(a))
        else:
            raise AssertionError(f"{type(group).__name__} has no picture")
    return ActuatorGeometry(
        np.concatenate(segments),
        np.concatenate(segment_owner).astype(np.int32),
        np.concatenate(faces) if faces else np.zeros((0, 3), np.int32),
        np.concatenate(face_owner).astype(np.int32),
        np.concatenate(points),
        np.concatenate(arrows),
        np.array(point_owner, np.int32),
    )


def _unit(v: Float[HostArray, "n 3"]) -> Float[HostArray, "n 3"]:
    return v / np.linalg.norm(v, axis=1, keepdims=True)
