"""Bundle adjustment: what it finds and how certain, from corners with known noise."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2

from benchmarks._photographs import phone, random_views
from softcal_jax.exchange.camera import tag_corners
from softcal_jax.exchange.camera._adjustment import (
    CameraModel,
    Observations,
    Placement,
    adjust,
    projected,
)

SIZE = 20e-3
NOISE = 0.1


def placed(rng):
    turn = Rotation.from_rotvec(rng.uniform(-0.6, 0.6, 3)).as_matrix()
    return Placement(turn, np.array([0.05, 0.02, 0.01]) + rng.uniform(-0.02, 0.02, 3))


def observed(lens, views, target, rng):
    """Corners of both tags on all photographs, by OpenCV, with noise."""
    corners = tag_corners(SIZE)
    points = np.tile(corners, (2 * len(views), 1))
    photo, which = np.divmod(np.arange(len(points)) // 4, 2)
    pixels = []
    for view in views:
        for place in (Placement(np.eye(3), np.zeros(3)), target):
            whole = view @ place
            pixels.append(lens.pixels(corners @ whole.R.T + whole.p))
    pixels = np.concatenate(pixels)
    return Observations(
        photo, which, points, pixels + NOISE * rng.normal(size=pixels.shape)
    )


def known(lens, share=1.0):
    """What a calibration leaves of the camera: one of many with its covariance."""
    values = np.array([lens.focal, *lens.middle, *lens.distortion])
    std = share * np.array([3.0, 3.0, 3.0, 5e-3, 2e-2, 2e-4, 2e-4, 2e-2])
    return CameraModel(values, np.diag(std**2))


def error(placement, true):
    turn = Rotation.from_matrix(true.R @ placement.R.T).as_rotvec()
    return np.concatenate([true.p - placement.p, turn])


def adjusted(seed, n):
    """Adjusts from near by, with a camera that is off as it is said to be."""
    rng, lens = np.random.default_rng(seed), phone()
    target = placed(rng)
    views = random_views(rng, 0.5 * target.p, n, away=0.4)
    seen = observed(lens, views, target, rng)
    exact = known(lens)
    off = np.linalg.cholesky(exact.covariance) @ rng.normal(size=8)
    camera = exact._replace(values=exact.values + off)
    near = lambda place: place.moved(1e-3 * rng.normal(size=6))
    fit = adjust(seen, camera, [near(v) for v in views], [near(target)])
    return fit, error(fit.targets[0], target)


def test_projection_is_that_of_opencv():
    """Camera, pose and the place of a target, each by OpenCV on its own."""
    rng, lens = np.random.default_rng(0), phone()
    target, (view,) = placed(rng), random_views(rng, np.zeros(3), 1, away=0.4)
    seen = observed(lens, [view], target, rng)
    values = known(lens).values
    pixels = projected(seen, values, [view, target], 1)
    whole = view @ target
    K = np.array([[values[0], 0, values[1]], [0, values[0], values[2]], [0, 0, 1]])
    turn = cv2.Rodrigues(whole.R)[0]
    expected, _ = cv2.projectPoints(tag_corners(SIZE), turn, whole.p, K, values[3:])
    np.testing.assert_allclose(pixels[4:], expected.reshape(-1, 2), atol=1e-6)


def test_noise_is_found_and_what_was_known_of_the_camera_improves():
    fit, off = adjusted(0, 12)
    assert fit.noise == pytest.approx(NOISE, rel=0.15)
    assert np.linalg.norm(off[:3]) < 0.3e-3
    before = np.diag(known(phone()).covariance)
    # But for the factor of Student's distribution, whose freedom is about 100.
    assert np.all(np.diag(fit.camera.covariance) <= 1.03 * before)
    # 16 coordinates on each photograph, less six for its pose and six for the target.
    free = 1.0 - (6 * 12 + 6) / (16 * 12)
    rms = float(np.sqrt(np.mean(fit.rms**2)))
    assert rms == pytest.approx(NOISE * np.sqrt(2.0 * free), rel=0.1)


def test_covariance_is_that_of_the_errors():
    """Their squares over it add up to a chi-squared number, in 99.9 % of all draws."""
    n = 12
    pairs = [adjusted(seed, 3) for seed in range(n)]
    total = sum(off @ np.linalg.solve(fit.covariance, off) for fit, off in pairs)
    low, high = chi2.ppf([0.0005, 0.9995], 6 * n)
    assert low < total < high


def coverage(n_trials, n_photos):
    squares = []
    for seed in range(n_trials):
        fit, off = adjusted(seed, n_photos)
        squares.append(off @ np.linalg.solve(fit.covariance, off))
    return int(np.sum(np.array(squares) < chi2.ppf(0.95, 6)))


@pytest.mark.slow
@pytest.mark.parametrize("n_photos", [2, 4, 8])
def test_coverage(n_photos):
    """Of the 95 % region, within what chance allows in 99 % of all runs."""
    n = 200
    low, high = binom.ppf([0.005, 0.995], n, 0.95)
    assert low <= coverage(n, n_photos) <= high


def test_too_few_corners():
    """Four corners of one tag say nothing of their noise."""
    rng, lens = np.random.default_rng(0), phone()
    (view,) = random_views(rng, np.zeros(3), 1, away=0.4)
    seen = observed(lens, [view], view, rng)
    one = Observations(*(part[:4] for part in seen))
    with pytest.raises(ValueError, match="4 corners are too few"):
        adjust(one, known(lens), [view], [])
