"""Lack of fit and left-out configurations, on models that are linear."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtrc
from scipy.stats import f as f_distribution

from softcal_jax.inference import (
    NOISE,
    ErrorColumns,
    chance,
    independent,
    jitter_freedom,
    lack_of_fit,
    no_errors,
    predicted_by_others,
    restricted_likelihood,
    uncertainty,
    whitened,
)

N_C, MARKERS, N_P = 4, 4, 2
SHAPE = (N_C, MARKERS, 3)
N = int(np.prod(SHAPE))
LANE = np.repeat(np.arange(N_C), 3 * MARKERS)
OFFSETS = np.einsum("cd,xy,m->cmxdy", np.eye(N_C), np.eye(3), np.ones(MARKERS))
OFFSETS = OFFSETS.reshape(N, 3 * N_C)
OWNER = np.repeat(np.arange(N_C), 3)


def fit(r, W, *, A=None, W_c=None, jitter=1.0, pose=None):
    """A linear fit with correlated columns A of its noise, and doubts W_c."""
    labelled = lambda X: ErrorColumns(X, ("offsets",) * X.shape[1], ("",) * X.shape[1])
    model = replace(
        independent(W, ("a", "b"), r=r, scale=jitter),
        poses=("0", "1", "2", "3"),
        pose=LANE if pose is None else pose,
    )
    if A is not None:
        model = replace(model, correlated=labelled(A / jitter))
    return model if W_c is None else replace(model, considered=labelled(W_c))


def draw(random, offset=0.0, jitter=0.7):
    """Errors of a right model, and W."""
    W = 3.0 * random.standard_normal((N, N_P)) + OFFSETS @ random.standard_normal(
        (3 * N_C, N_P)
    )
    r = jitter * random.standard_normal(N)
    return r + offset * OFFSETS @ random.standard_normal(3 * N_C), W


def test_whitening_is_the_root_of_the_inverse_covariance():
    random = np.random.default_rng(0)
    A = random.standard_normal((8, 5)) * [1.0, 1e3, 1e-3, 0.0, 1.0]
    V = np.eye(8) + A @ A.T
    size, P = np.linalg.eigh(V)
    root = (P / np.sqrt(size)) @ P.T
    np.testing.assert_allclose(whitened(A, np.eye(8)), root, atol=1e-9)


def test_products_are_those_of_dense_matrices():
    random = np.random.default_rng(1)
    r, W = draw(random)
    A, s = 0.8 * OFFSETS, 0.6
    V = s**2 * np.eye(N) + A @ A.T
    inverse = np.linalg.inv(V)
    C = np.linalg.inv(W.T @ inverse @ W)
    M = inverse - inverse @ W @ C @ W.T @ inverse
    linear = fit(r, W, A=A, jitter=s)
    np.testing.assert_allclose(linear.left(np.eye(N)), M, atol=1e-10)
    np.testing.assert_allclose(linear.errors_left(), M @ r, atol=1e-10)
    np.testing.assert_allclose(linear.covariance(), C, rtol=1e-10)
    np.testing.assert_allclose(linear.gain(), C @ W.T @ inverse, atol=1e-10)
    np.testing.assert_allclose(linear.step(), -C @ W.T @ inverse @ r, atol=1e-10)
    by_jitter = s**2 * linear.gain() @ linear.gain().T
    np.testing.assert_allclose(linear.covariance(NOISE), by_jitter, rtol=1e-10)
    np.testing.assert_allclose(linear.covariance("offsets"), C - by_jitter, rtol=1e-8)
    with pytest.raises(ValueError, match=r"cause.*wind.*offsets"):
        linear.covariance("wind")


def lack(r, W, **changed):
    return lack_of_fit(fit(r, W, **changed), OFFSETS, OWNER)


def test_without_offsets_it_is_the_f_test_of_nested_models():
    r, W = draw(np.random.default_rng(2), offset=0.3)
    squares = lambda X: float(np.sum((r - X @ np.linalg.lstsq(X, r)[0]) ** 2))
    few, many = squares(W), squares(np.concatenate([W, OFFSETS], axis=1))
    between, within = 3 * N_C, N - 3 * N_C - N_P
    ratio = (few - many) / between / (many / within)
    test = lack(r, W)
    assert (test.between, test.within) == (between, within)
    np.testing.assert_allclose(test.ratio, ratio, rtol=1e-9)
    np.testing.assert_allclose(test.jitter, np.sqrt(many / within), rtol=1e-9)
    expected = f_distribution.sf(ratio, between, within)
    np.testing.assert_allclose(test.probability, expected, rtol=1e-9)


@pytest.mark.parametrize("offset", [0.0, 0.5, 5.0])
def test_a_right_model_is_flagged_as_seldom_as_stated(offset):
    """300 draws; exact without offsets, and on the safe side with stated ones."""
    random = np.random.default_rng(3)
    chances = [
        lack(*draw(random, offset), A=offset * OFFSETS).probability for _ in range(300)
    ]
    for level in (0.01, 0.1):
        # Three standard deviations of a count of 300.
        most = level + 3.0 * np.sqrt(level / 300)
        assert np.mean(np.array(chances) < level) < most
    if offset == 0.0:
        assert np.mean(np.array(chances) < 0.5) == pytest.approx(0.5, abs=0.09)


def test_a_configuration_that_is_off_as_a_whole_is_named():
    r, W = draw(np.random.default_rng(4), offset=0.5)
    r[LANE == 2] += 5.0 * OFFSETS[LANE == 2, 6]
    test = lack(r, W, A=0.5 * OFFSETS)
    assert test.probability < 1e-3
    assert np.argmax(test.shares) == 2
    np.testing.assert_allclose(np.sum(test.shares), 1.0)
    # What is held fixed and may be wrong by that much explains it.
    error = np.where(LANE == 2, 5.0 * OFFSETS[:, 6], 0.0)[:, None]
    assert lack(r, W, A=0.5 * OFFSETS, W_c=error).probability > 0.01


def test_one_marker_in_each_pose_has_no_scatter_within():
    few = np.flatnonzero(np.arange(N) // 3 % MARKERS == 0)
    r, W = draw(np.random.default_rng(5))
    linear = fit(r[few], W[few], pose=LANE[few])
    assert lack_of_fit(linear, OFFSETS[few], OWNER) is None


def test_a_left_out_configuration_is_that_of_a_fit_to_the_others():
    """Generalised least squares of all rows but those, by dense matrices."""
    r, W = draw(np.random.default_rng(6), offset=0.5)
    A, s = 0.5 * OFFSETS, 0.7
    W_c = np.random.default_rng(7).standard_normal((N, 2))
    linear = fit(r, W, A=A, W_c=W_c, jitter=s)
    for c, pose in enumerate(predicted_by_others(linear)):
        kept, out = LANE != c, LANE == c
        V = s**2 * np.eye(N) + A @ A.T
        inverse = np.linalg.inv(V[np.ix_(kept, kept)])
        C = np.linalg.inv(W[kept].T @ inverse @ W[kept])
        gain = C @ W[kept].T @ inverse
        predicted = r[out] - W[out] @ gain @ r[kept]
        by_fixed = W_c[out] - W[out] @ gain @ W_c[kept]
        covariance = V[np.ix_(out, out)] + W[out] @ C @ W[out].T
        covariance += by_fixed @ by_fixed.T
        np.testing.assert_allclose(pose.error, predicted, atol=1e-10)
        np.testing.assert_allclose(pose.std, np.sqrt(np.diag(covariance)), rtol=1e-8)
        squares = predicted @ np.linalg.solve(covariance, predicted)
        np.testing.assert_allclose(pose.chi_squared, squares, rtol=1e-7)
        assert pose.degrees_of_freedom == 3 * MARKERS


def test_a_parameter_that_only_one_configuration_shows_cannot_be_predicted():
    r, W = draw(np.random.default_rng(8))
    W[LANE != 1, 1] = 0.0
    predicted = predicted_by_others(fit(r, W, jitter=0.7))
    assert np.isnan(predicted[1].error).any()
    assert predicted[1].degrees_of_freedom == 3 * MARKERS - 1
    assert not np.isnan(predicted[0].error).any()


def test_right_predictions_are_flagged_as_seldom_as_stated():
    random, chances = np.random.default_rng(9), []
    for _ in range(200):
        r, W = draw(random, offset=0.5)
        linear, A = fit(r, W, A=0.5 * OFFSETS), 0.5 * OFFSETS
        jitter, _ = restricted_likelihood(linear, [A], [1.0, 1.0], [True, False])
        for pose in predicted_by_others(linear.with_jitter(jitter)):
            n = pose.degrees_of_freedom
            squares = pose.chi_squared
            chances.append(chance(squares, n, of=N - N_P, jitter_is_of_all=True))
    for level in (0.01, 0.1):
        assert np.mean(np.array(chances) < level) < level + 3.0 * np.sqrt(level / 800)


def test_a_right_std_is_flagged_as_seldom_as_stated():
    """Two markers in three poses, with offsets of five times the jitter.

    Offsets cover half of the 18 coordinates; by 16 degrees of freedom, coordinates
    minus parameters, a right std would be flagged several times too often.
    """
    few = np.flatnonzero((np.arange(N) // 3 % MARKERS < 2) & (LANE < 3))
    A = 5.0 * OFFSETS[few][:, :9]
    random, chances = np.random.default_rng(10), []
    for _ in range(400):
        r, W = (x[few] for x in draw(random, offset=5.0, jitter=1.0))
        linear = fit(r, W, A=A, pose=LANE[few])
        dof = jitter_freedom(linear)
        assert 7.0 < dof < 9.1
        level, _ = restricted_likelihood(linear, [A], [1.0, 1.0], [True, False])
        chances.append(chdtrc(dof, dof * level**2))
    for limit in (0.01, 0.1):
        assert np.mean(np.array(chances) < limit) < limit + 3.0 * np.sqrt(limit / 400)


def test_independent_residuals_all_tell_of_the_jitter():
    """Without offsets their number is that of coordinates minus parameters."""
    linear = fit(*draw(np.random.default_rng(11)), jitter=0.6)
    np.testing.assert_allclose(jitter_freedom(linear), N - N_P)


def test_chance_is_that_of_the_tables():
    """Upper 5 % points: chi-squared 7.815 for 3, F 3.49 for 3 and 12."""
    assert chance(7.815, 3) == pytest.approx(0.05, rel=1e-3)
    assert chance(3 * 3.49, 3, of=12) == pytest.approx(0.05, rel=1e-2)
    assert np.isnan(chance(1.0, 0))


def test_chi_squared_counts_all_errors():
    """The least r^T V^-1 r and its number, with the dense covariance of all errors."""
    random = np.random.default_rng(3)
    r, W = draw(random)
    A, W_c = random.standard_normal((N, 3)), 2.0 * random.standard_normal((N, 5))
    weights, distance = np.array([0.7, 0.0]), np.array([0.4, 0.0])
    linear = replace(
        fit(r, W, A=A, W_c=W_c, jitter=0.7),
        prior_weights=weights,
        from_prior=distance,
    )
    V = 0.7**2 * np.eye(N) + A @ A.T + W_c @ W_c.T
    inverse, P = np.linalg.inv(V), np.diag(weights**2)
    dz = -np.linalg.solve(W.T @ inverse @ W + P, W.T @ inverse @ r + weights * distance)
    left, off = r + W @ dz, distance + weights * dz
    squares, n = linear.chi_squared()
    assert squares == pytest.approx(left @ inverse @ left + off @ off, rel=1e-9)
    assert n == N + 1 - N_P
    spread = uncertainty(replace(linear, correlated=no_errors(N), scale=1.0), "stated")
    assert spread.degrees_of_freedom == n


def test_what_is_considered_explains_residuals():
    """Errors as large as stated are no misfit; three times as large, they are."""
    random, excess = np.random.default_rng(4), {1.0: [], 3.0: []}
    for size in excess:
        for _ in range(50):
            r, W = draw(random, jitter=1.0)
            W_c = 5.0 * random.standard_normal((N, 6))
            linear = fit(r + size * W_c @ random.standard_normal(6), W, W_c=W_c)
            excess[size].append(uncertainty(linear, "stated").misfits)
    assert np.mean(excess[1.0]) <= 0.06
    assert np.mean(excess[3.0]) > 0.5
