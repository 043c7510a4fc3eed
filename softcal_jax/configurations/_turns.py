"""Rotation matrices from the angles or quaternions that a tracker writes."""

import warnings
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray

ANGLES = ("azimuth", "elevation", "roll")

RADIANS = {"deg": np.pi / 180.0, "rad": 1.0}
"""Units of angles."""

_UNIT_LENGTH = 1e-3
"""Largest error of a quaternion's length, more than rounding to four digits gives."""


class TrackerWarning(UserWarning):
    """Something in a tracker's file that is probably a mistake."""


def from_quaternions(
    path: Path, lines: tuple[int, ...], quaternions: Float[HostArray, "n 4"]
) -> Float[HostArray, "n 3 3"]:
    """Convert quaternions, scalar part first, to rotation matrices [-].

    Args:
        path: File that they were read from, for messages.
        lines: Their lines.
        quaternions: Their components [-].

    Raises:
        ValueError: If one is not of unit length.
    """
    lengths = np.linalg.norm(quaternions, axis=1)
    bad = np.flatnonzero(np.abs(lengths - 1.0) > _UNIT_LENGTH)
    if bad.size:
        raise ValueError(
            f"{path}, line {lines[bad[0]]}: the quaternion has the length "
            f"{lengths[bad[0]]:.6g}, not 1: write four digits or more, and neither "
            "scale nor average quaternions."
        )
    return Rotation.from_quat(quaternions[:, [1, 2, 3, 0]]).as_matrix()


def from_angles(
    path: Path,
    lines: tuple[int, ...],
    angles: Float[HostArray, "n 3"],
    *,
    unit: str,
    remedy: str,
) -> Float[HostArray, "n 3 3"]:
    """Compute rotation matrices Rz(azimuth) Ry(elevation) Rx(roll) [-].

    Args:
        path: File that the angles were read from, for messages.
        lines: Their lines.
        angles: Azimuth, elevation and roll [deg or rad].
        unit: "deg" or "rad".
        remedy: How to state another unit; "{unit}" stands for it.

    Raises:
        ValueError: If an angle is out of its range.
    """
    # With some tolerance, since trackers print few digits: 1.571 is a right angle.
    limits = np.array([2.0 * np.pi, np.pi / 2.0, 2.0 * np.pi]) / RADIANS[unit]
    outside = np.argwhere(np.abs(angles) > 1.001 * limits)
    if outside.size:
        row, k = outside[0]
        hint = ""
        if unit == "rad":
            hint = f" If it is in degrees, {remedy.format(unit='deg')}."
        raise ValueError(
            f"{path}, line {lines[row]}: the {ANGLES[k]} is {angles[row, k]:g} {unit}, "
            f"beyond {limits[k]:.4g} {unit}.{hint}"
        )
    if unit == "deg" and _like_radians(angles):
        warnings.warn(
            f"{path}: every angle lies within half a turn if it is in radians. If they "
            f"are not degrees, {remedy.format(unit='rad')}.",
            TrackerWarning,
            stacklevel=3,
        )
    return Rotation.from_euler("ZYX", angles * RADIANS[unit]).as_matrix()


def _like_radians(angles: Float[HostArray, "n 3"]) -> bool:
    """Return whether all numbers could be radians, and are too large to ignore."""
    sizes = np.abs(angles).max(axis=0)
    return bool((sizes <= [3.142, 1.571, 3.142]).all() and sizes.max() > 1.0)
