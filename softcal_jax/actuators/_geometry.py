"""What to draw of actuators: segments of cables, walls, points and axes."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray, Int


class ActuatorGeometry(NamedTuple):
    """Actuators as lines, faces and points, each with the index of its actuator.

    Attributes:
        segments: Ends of the segments of cables [m].
        segment_owner: Their cables.
        faces: Nodes of the faces of chambers and surface pressures.
        face_owner: Their actuators.
        points: Mean point of action of a force, or origin of the frame that a motor
            turns [m].
        arrows: Direction of a force, or the axis of a motor [-].
        point_owner: Their actuators.
    """

    segments: Float[HostArray, "n_segments 2 3"] = np.zeros((0, 2, 3))
    segment_owner: Int[HostArray, " n_segments"] = np.zeros(0, np.int32)
    faces: Int[HostArray, "n_faces n_fn"] = np.zeros((0, 3), np.int32)
    face_owner: Int[HostArray, " n_faces"] = np.zeros(0, np.int32)
    points: Float[HostArray, "n_markers 3"] = np.zeros((0, 3))
    arrows: Float[HostArray, "n_markers 3"] = np.zeros((0, 3))
    point_owner: Int[HostArray, " n_markers"] = np.zeros(0, np.int32)


def joined(pictures: Sequence[ActuatorGeometry]) -> ActuatorGeometry:
    """Join all pictures into one."""
    fields = zip(ActuatorGeometry(), *pictures, strict=True)
    return ActuatorGeometry(*(_stacked(*parts) for parts in fields))


def _stacked(none: HostArray, *parts: HostArray) -> HostArray:
    # Skip empty parts: faces of a quadratic mesh have more nodes than those of `none`.
    some = [part for part in parts if len(part)]
    return np.concatenate(some).astype(none.dtype) if some else none


def unit(v: Float[HostArray, "n 3"]) -> Float[HostArray, "n 3"]:
    """Normalise vectors [-]."""
    return v / np.linalg.norm(v, axis=1, keepdims=True)
