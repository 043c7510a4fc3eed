"""Rigid motions: translation and rotation."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray

Vector = Sequence[float] | Float[ArrayLike, "3"]
"""Three numbers, as a user types them."""


def as_vector(value: Vector) -> Float[HostArray, "3"]:
    """Convert a user's three numbers to an array."""
    return np.array(value, float)  # a copy: SciPy's rotations need it writable


def check_vector(what: str, unit: str, value: HostArray) -> None:
    """Raise ValueError unless a vector has three finite numbers."""
    if value.shape != (3,) or not np.all(np.isfinite(value)):
        raise ValueError(f"{what} must be three finite numbers [{unit}], got {value}.")


class Pose(eqx.Module):
    """Rigid motion X -> rotation @ (X - origin) + origin + translation.

    The origin is that of the moving frame; for a body `RigidBody.origin`.

    Attributes:
        translation: Displacement of the origin [m].
        rotation_vector: Axis of the rotation times its angle [rad].
    """

    translation: Float[HostArray, "3"] = eqx.field(
        converter=as_vector, default_factory=lambda: np.zeros(3)
    )
    rotation_vector: Float[HostArray, "3"] = eqx.field(
        converter=as_vector, default_factory=lambda: np.zeros(3)
    )

    def __check_init__(self):
        check_vector("translation", "m", self.translation)
        check_vector("rotation_vector", "rad", self.rotation_vector)
        angle = float(np.linalg.norm(self.rotation_vector))
        if angle > 2.0 * np.pi:
            raise ValueError(
                f"rotation_vector turns by {angle:.4g} rad, more than a full turn: "
                "give radians, not degrees (np.deg2rad)."
            )

    @classmethod
    def from_matrix(
        cls, rotation: Float[ArrayLike, "3 3"], translation: Float[ArrayLike, "3"]
    ) -> "Pose":
        """Make a pose from a rotation matrix [-] and a translation [m].

        Raises:
            ValueError: If the matrix is not a rotation.
        """
        R = np.array(rotation, float)
        if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-6):
            raise ValueError(f"rotation must be an orthogonal 3 x 3 matrix, got {R}.")
        if np.linalg.det(R) < 0.0:
            raise ValueError("rotation mirrors space (its determinant is -1).")
        return cls(np.asarray(translation, float), Rotation.from_matrix(R).as_rotvec())

    @property
    def matrix(self) -> Float[HostArray, "3 3"]:
        """The rotation as a matrix [-]."""
        return Rotation.from_rotvec(self.rotation_vector).as_matrix()
