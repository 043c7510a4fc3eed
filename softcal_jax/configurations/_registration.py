"""From the frame of the cameras to the frame of the mesh."""

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray


class Registration(eqx.Module):
    """A rigid motion fitted to markers that are known in both frames.

    Attributes:
        rotation: Rotation matrix, camera axes to mesh axes [-].
        translation: Translation after the rotation [m].
        residuals: What the motion leaves at each marker used, in the mesh frame [m].
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
        """Points of the camera frame in the mesh frame [m]."""
        return np.asarray(points, float) @ self.rotation.T + self.translation


def register(
    measured: Float[ArrayLike, "n_markers 3"],
    nominal: Float[ArrayLike, "n_markers 3"],
    *,
    weights: Float[ArrayLike, " n_markers"] | None = None,
) -> Registration:
    """Rigid motion that best takes measured markers onto their nominal positions.

    The weighted least-squares rotation of Kabsch (Acta Cryst. A32, 1976), by
    `scipy.spatial.transform.Rotation.align_vectors`.

    Args:
        measured: Positions in the camera frame [m].
        nominal: The same markers in the mesh frame [m].
        weights: Weight of each marker [-]; equal by default.

    Returns:
        The motion and what it leaves at each marker.

    Raises:
        ValueError: If fewer than three markers are given, they lie on a line, their
            numbers differ, or a value is not finite.
    """
    measured, nominal = np.asarray(measured, float), np.asarray(nominal, float)
    if measured.shape != nominal.shape or measured.ndim != 2 or measured.shape[1] != 3:
        raise ValueError(
            "registration needs as many measured as nominal markers, shape "
            f"(n, 3) each [m], got {measured.shape} and {nominal.shape}."
        )
    if len(measured) < 3:
        raise ValueError(f"registration needs at least 3 markers, got {len(measured)}.")
    if not (np.all(np.isfinite(measured)) and np.all(np.isfinite(nominal))):
        raise ValueError(
            "registration markers must be finite; drop those that are not."
        )
    w = np.ones(len(measured)) if weights is None else np.asarray(weights, float)
    centre_m, centre_n = np.average(measured, 0, w), np.average(nominal, 0, w)
    spread = np.linalg.svd(nominal - centre_n, compute_uv=False)
    if spread[1] < 1e-6 * spread[0]:
        raise ValueError(
            "registration markers lie on a line, which leaves a rotation free: "
            "choose three that span a triangle."
        )
    turn, *_ = Rotation.align_vectors(
        nominal - centre_n, measured - centre_m, weights=w
    )
    R = turn.as_matrix()
    t = centre_n - R @ centre_m
    return Registration(R, t, measured @ R.T + t - nominal)
