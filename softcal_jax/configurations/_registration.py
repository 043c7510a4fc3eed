"""Registration: from the frame of the cameras to the frame of the mesh."""

import warnings

import numpy as np
from jaxtyping import ArrayLike
from scipy.spatial.transform import Rotation

from softcal_jax._module import Module
from softcal_jax._typing import Float, HostArray


class Registration(Module):
    """A rigid motion fitted to markers that are known in both frames.

    Attributes:
        rotation: Rotation matrix, camera axes to mesh axes [-].
        translation: Translation after the rotation [m].
        residuals: Residual of each marker used, in the mesh frame [m].
    """

    rotation: Float[HostArray, "3 3"]
    translation: Float[HostArray, "3"]
    residuals: Float[HostArray, "n_used 3"]

    @property
    def rms(self) -> float:
        """Root mean square of the residual distances [m]."""
        return float(np.sqrt(np.mean(np.sum(self.residuals**2, axis=1))))

    def apply(
        self, points: Float[ArrayLike, "n_points 3"]
    ) -> Float[HostArray, "n_points 3"]:
        """Move points from the camera frame to the mesh frame [m]."""
        return np.asarray(points, float) @ self.rotation.T + self.translation


def register(
    measured: Float[ArrayLike, "n_markers 3"], nominal: Float[ArrayLike, "n_markers 3"]
) -> Registration:
    """Fit the rigid motion that takes measured markers onto nominal positions.

    The least-squares rotation of Kabsch (Acta Cryst. A32, 1976), by
    `scipy.spatial.transform.Rotation.align_vectors`. Positions are `measured` in the
    camera frame and `nominal` in the mesh frame [m].

    Raises:
        ValueError: If there are not three finite markers in both that span a triangle,
            or the two sets are so unlike that no rotation is best.
    """
    measured, nominal = np.asarray(measured, float), np.asarray(nominal, float)
    if measured.shape != nominal.shape or measured.ndim != 2 or measured.shape[1] != 3:
        raise ValueError(
            "registration needs as many measured as nominal markers, shape "
            f"(n, 3) each [m], got {measured.shape} and {nominal.shape}."
        )
    if len(measured) < 3 or not np.all(np.isfinite([measured, nominal])):
        raise ValueError(
            f"registration needs at least 3 markers, got {len(measured)}; their "
            "positions must be finite."
        )
    centre_m, centre_n = measured.mean(axis=0), nominal.mean(axis=0)
    for kind, points in (("measured", measured), ("nominal", nominal)):
        _check_spread(kind, points)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            turn, *_ = Rotation.align_vectors(nominal - centre_n, measured - centre_m)
    except UserWarning as error:
        raise ValueError(
            "no rotation takes the measured markers best onto the nominal ones: check "
            "that both list the same markers in the same order."
        ) from error
    R = turn.as_matrix()
    t = centre_n - R @ centre_m
    return Registration(R, t, measured @ R.T + t - nominal)


def _check_spread(kind: str, points: Float[HostArray, "n 3"]) -> None:
    """Raise unless the points span a triangle."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    # Far from the origin, rounding spreads even points that coincide.
    if spread[1] <= max(1e-6 * spread[0], 1e-12 * np.abs(points).max()):
        raise ValueError(
            f"the {kind} markers of the registration lie on a line, which leaves a "
            "rotation free: choose at least three that span a triangle, and check "
            "their positions."
        )
