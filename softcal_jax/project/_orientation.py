"""Orientations and poses of frames, as a project file writes them."""

import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray
from softcal_jax.bodies import Pose
from softcal_jax.project._schema_effectors import FrameTable, OrientationTable

_UNIT_LENGTH = 1e-3
"""How far a quaternion may be from unit length: beyond what four digits round."""


def rotation_of(table: OrientationTable) -> Float[HostArray, "3 3"]:
    """Rotation matrix, from the axes of the frame to those it is given in [-].

    The angles are those of Polhemus: R = Rz(azimuth) Ry(elevation) Rx(roll).

    Raises:
        ValueError: If a quaternion is not of unit length.
    """
    if table.quaternion is not None:
        w, *xyz = table.quaternion
        length = float(np.linalg.norm(table.quaternion))
        if not abs(length - 1.0) <= _UNIT_LENGTH:
            raise ValueError(
                f"quaternion has the length {length:.6g}, not 1: write four digits or "
                "more, the scalar part first."
            )
        return Rotation.from_quat([*xyz, w]).as_matrix()
    if table.rotation_vector is not None:
        return Rotation.from_rotvec(table.rotation_vector).as_matrix()
    angles = [table.azimuth or 0.0, table.elevation or 0.0, table.roll or 0.0]
    return Rotation.from_euler("ZYX", angles).as_matrix()


def frame_of(table: FrameTable) -> Pose:
    """Where a frame stands: from its coordinates to those it is given in."""
    return Pose.from_matrix(rotation_of(table), np.array(table.position))
