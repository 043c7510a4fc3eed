import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softcal_jax.readings import register

RNG = np.random.default_rng(0)
NOMINAL = RNG.uniform(-0.1, 0.1, (6, 3))
Q, T = Rotation.random(rng=1).as_matrix(), np.array([1.2, -0.7, 3.1])
# What the cameras see: the registration has to undo this motion.
SEEN = (NOMINAL - T) @ Q
LINE = np.outer(np.arange(4.0), T)


def test_recovers_a_rigid_motion():
    fit = register(SEEN, NOMINAL)
    # Rounding of positions of a few metres.
    np.testing.assert_allclose(fit.rotation, Q, rtol=0, atol=1e-13)
    np.testing.assert_allclose(fit.translation, T, rtol=0, atol=1e-13)
    np.testing.assert_allclose(fit.apply(SEEN), NOMINAL, rtol=0, atol=1e-14)
    assert fit.rms < 1e-14


def test_three_markers_are_enough_and_give_no_reflection():
    fit = register(SEEN[:3], NOMINAL[:3])
    np.testing.assert_allclose(fit.rotation, Q, rtol=0, atol=1e-12)
    mirrored = NOMINAL * np.array([1.0, 1.0, -1.0])
    assert np.linalg.det(register(mirrored, NOMINAL).rotation) > 0


def test_one_marker_is_enough_where_the_rotation_is_known():
    fit = register(SEEN[:1], NOMINAL[:1], rotation=Q)
    np.testing.assert_allclose(fit.apply(SEEN), NOMINAL, rtol=0, atol=1e-14)
    with pytest.raises(ValueError, match="at least 1 finite marker"):
        register(SEEN[:0], NOMINAL[:0], rotation=Q)


def test_residuals_are_what_is_left():
    """A stretch of 1 % cannot be registered away: it stays in the residual."""
    seen = 1.01 * SEEN
    fit = register(seen, NOMINAL)
    left = 0.01 * (NOMINAL - NOMINAL.mean(axis=0))
    np.testing.assert_allclose(fit.residuals, left, rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        fit.rms, np.sqrt(np.mean(np.sum(left**2, axis=1))), rtol=1e-10
    )


def test_noise_is_not_fitted_better_than_it_can_be():
    """Six of 18 numbers go into the motion, so 12/18 of the variance stays."""
    noise = 1e-4 * RNG.normal(size=(400, 6, 3))
    squares = [np.sum(register(SEEN + e, NOMINAL).residuals ** 2) for e in noise]
    # The mean of 400 sums of 12 squares scatters by sqrt(2 / 4800) = 2 %.
    np.testing.assert_allclose(np.mean(squares), 12 * 1e-8, rtol=0.08)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("seen", "nominal", "message"),
    [
        (SEEN[:2], NOMINAL[:2], "3 finite markers, got 2"),
        (SEEN[:5], NOMINAL, r"as many .*\(5, 3\) and \(6, 3\)"),
        (SEEN[:, :2], NOMINAL[:, :2], r"\(n, 3\) .*\(6, 2\) and \(6, 2\)"),
        (np.where(SEEN == SEEN[1], np.nan, SEEN), NOMINAL, "finite markers, got 6"),
        (LINE, LINE, "measured .*on a line"),
        (SEEN[:4], LINE, "nominal .*on a line"),
        (LINE, NOMINAL[:4], "measured .*at least three"),
        (SEEN[:4], np.tile(T, (4, 1)), "nominal .*on a line"),
        (np.tile(T, (4, 1)), NOMINAL[:4], "measured .*on a line"),
    ],
)
def test_bad_registration(seen, nominal, message):
    with pytest.raises(ValueError, match=message):
        register(seen, nominal)
