"""Bundle adjustment: camera, its poses, and targets on the photographs, all at once.

Least squares of the reprojection errors of all corners (Triggs et al., "Bundle
adjustment - a modern synthesis", 1999), with the lens of Brown (1971) as OpenCV has it.
The covariance is that of the linearised problem, with the noise of a corner estimated
from the remaining errors.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.exchange.camera._sheet import opencv

_N_CAMERA = 8
_ROUNDS = 4  # rounds of adjustment, each with the noise estimated in the round before

_FIRST_NOISE, _LEAST_NOISE = 0.1, 1e-4
"""Noise of a corner to begin with, and where everything fits to rounding [px]."""


class CameraModel(NamedTuple):
    """A camera with square pixels, and the covariance of its values.

    Its values are the focal length f, principal point cx, cy [px], and the distortion
    k1, k2, p1, p2, k3 [-].
    """

    values: Float[HostArray, "8"]
    covariance: Float[HostArray, "8 8"]

    @classmethod
    def unknown(cls, size: tuple[int, int], focal: float) -> "CameraModel":
        """Return what is known of any phone from the size of its photographs [px]."""
        longest = max(size)
        # Principal points lie within some percent of the middle, and the software of
        # phones leaves a few percent of distortion at the corners.
        std = [0.5 * focal, 0.02 * longest, 0.02 * longest]
        std += [0.1, 0.1, 2e-3, 2e-3, 0.1]
        middle = 0.5 * (np.array(size) - 1.0)
        return cls(np.array([focal, *middle, 0, 0, 0, 0, 0]), np.diag(np.square(std)))


def lens(values: Float[HostArray, "8"]) -> tuple:
    """Return the matrix of a camera [px] and its distortion [-], for OpenCV."""
    f, cx, cy = values[:3]
    return np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]]), values[3:]


class Placement(NamedTuple):
    """A rigid motion x -> R x + p [m]."""

    R: Float[HostArray, "3 3"]
    p: Float[HostArray, "3"]

    def __matmul__(self, other: "Placement") -> "Placement":
        """Return this motion after another one."""
        return Placement(self.R @ other.R, self.R @ other.p + self.p)

    @property
    def inverse(self) -> "Placement":
        """The motion back."""
        return Placement(self.R.T, -self.R.T @ self.p)

    def moved(self, step: Float[HostArray, "6"]) -> "Placement":
        """Return p + step[:3] and exp(step[3:]) R."""
        return Placement(
            Rotation.from_rotvec(step[3:]).as_matrix() @ self.R, self.p + step[:3]
        )


class Observations(NamedTuple):
    """Corners, in the frames of their targets [m] and on photographs [px].

    Target 0 is on all photographs; the other targets have fixed poses in its frame.
    """

    photo: Int[HostArray, " n"]
    target: Int[HostArray, " n"]
    points: Float[HostArray, "n 3"]
    pixels: Float[HostArray, "n 2"]

    def in_base(self, others: Sequence[Placement]) -> Float[HostArray, "n 3"]:
        """Return the points in the frame of target 0, given the other targets [m]."""
        still = Placement(np.eye(3), np.zeros(3))
        R, p = map(np.stack, zip(*(still, *others), strict=True))
        return np.einsum("nij,nj->ni", R[self.target], self.points) + p[self.target]


class Adjustment(NamedTuple):
    """Result of a bundle adjustment.

    `targets` are the poses of the other targets in the frame of target 0. `covariance`
    is theirs: six rows each, of p and of a rotation vector in the axes of target 0
    [m, rad]. `noise` is the standard deviation of a coordinate of a corner and `rms`
    the root mean square of the errors of each photograph [px].
    """

    camera: CameraModel
    targets: tuple[Placement, ...]
    covariance: Float[HostArray, "n n"]
    noise: float
    rms: Float[HostArray, " n_photos"]


def adjust(
    seen: Observations,
    camera: CameraModel,
    poses: Sequence[Placement],
    targets: Sequence[Placement],
) -> Adjustment:
    """Fit camera, poses and targets to what was seen, beginning at those given."""
    # Imported here, so that other commands do not wait for it.
    from scipy.optimize import least_squares

    values, placements, noise = camera.values, (*poses, *targets), _FIRST_NOISE
    n_photos, n_pixels = len(poses), seen.pixels.size
    std = np.sqrt(np.diag(camera.covariance))
    root = np.linalg.cholesky(camera.covariance)

    def after(x: Float[HostArray, " n"]) -> tuple:
        """Take steps: of the camera in standard deviations, then six a placement."""
        pairs = zip(placements, x[_N_CAMERA:].reshape(-1, 6), strict=True)
        return values + std * x[:_N_CAMERA], tuple(pose.moved(d) for pose, d in pairs)

    def residuals(x: Float[HostArray, " n"]) -> Float[HostArray, " m"]:
        """Return errors of corners, then of the camera, in standard deviations."""
        new_values, new_placements = after(x)
        pixels = projected(seen, new_values, new_placements, n_photos)
        off = np.linalg.solve(root, new_values - camera.values)
        return np.concatenate([((pixels - seen.pixels) / noise).ravel(), off])

    inverse, freedom, errors = np.empty(0), np.nan, np.empty(0)
    for _ in range(_ROUNDS):
        start = np.zeros(_N_CAMERA + 6 * len(placements))
        fit = least_squares(residuals, start, method="lm", xtol=1e-12)
        inverse, freedom = _inverse_normal(fit.jac, n_pixels)
        errors = noise * fit.fun[:n_pixels]
        values, placements = after(fit.x)
        noise = max(float(np.sqrt(errors @ errors / freedom)), _LEAST_NOISE)
    # The variance of Student's distribution, for a noise that is itself estimated.
    H = freedom / (freedom - 2.0) * inverse
    first = _N_CAMERA + 6 * n_photos
    squares = np.square(errors.reshape(-1, 2)).sum(axis=1)
    count = np.bincount(seen.photo, minlength=n_photos)
    return Adjustment(
        camera=CameraModel(values, H[:_N_CAMERA, :_N_CAMERA] * np.outer(std, std)),
        targets=placements[n_photos:],
        covariance=H[first:, first:],
        noise=noise,
        rms=np.sqrt(np.bincount(seen.photo, squares, n_photos) / count),
    )


def _inverse_normal(
    J: Float[HostArray, "m n"], n_pixels: int
) -> tuple[Float[HostArray, "n n"], float]:
    """Return (J^T J)^-1, and the degrees of freedom of the errors of corners.

    These are the number of errors less that of the unknowns that they determine; what
    was known of the camera determines the rest.
    """
    # Metres and radians differ in size, so that the columns are scaled first.
    scale = np.linalg.norm(J, axis=0)
    J = J / scale
    H = np.linalg.inv(J.T @ J)
    seen = J[:n_pixels]
    freedom = n_pixels - float(np.sum((seen @ H) * seen))
    if not freedom > 2.0:
        raise ValueError(
            f"{n_pixels // 2} corners are too few to tell their noise; take more "
            "photographs."
        )
    return H / np.outer(scale, scale), freedom


def projected(
    seen: Observations,
    camera: Float[HostArray, "8"],
    placements: Sequence[Placement],
    n_photos: int,
) -> Float[HostArray, "n 2"]:
    """Project the corners onto the photographs [px].

    Placements are poses of target 0 in the camera, one per photograph, then those of
    the other targets in target 0.
    """
    R, p = map(np.stack, zip(*placements[:n_photos], strict=True))
    x = seen.in_base(placements[n_photos:])
    x = np.einsum("nij,nj->ni", R[seen.photo], x) + p[seen.photo]
    zero = np.zeros(3)
    pixels, _ = opencv().projectPoints(x[:, None], zero, zero, *lens(camera))
    return pixels.reshape(-1, 2)
