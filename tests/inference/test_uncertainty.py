"""Covariances in closed form, and blind directions."""

from dataclasses import replace

import numpy as np
import pytest

from softcal_jax.inference import independent, uncertainty


def stated(W, at_bound=None):
    """Covariance with the noise taken as stated, three measured coordinates."""
    return uncertainty(linear(W, at_bound), "stated").covariance


def linear(W, at_bound=None, r=None):
    """A fit with independent errors."""
    W = np.array(W, float)
    held = np.zeros(W.shape[1], bool) if at_bound is None else np.array(at_bound)
    names = tuple("abcd"[: W.shape[1]])
    return replace(independent(W, names, r=r), held=held)


def test_without_a_blind_direction_it_is_the_inverse():
    """(W^T W)^-1 of [[4, 2], [2, 2]]."""
    np.testing.assert_allclose(
        stated([[2.0, 1.0], [0.0, 1.0], [0.0, 0.0]]),
        [[0.5, -0.5], [-0.5, 1.0]],
        rtol=1e-12,
    )


def test_blind_direction_takes_the_error_of_its_parameters_only():
    """Of c and d only the sum is seen; a and b are as if those two were not there."""
    W = [[2.0, 1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 3.0, 3.0]]
    covariance = stated(W)
    expected = np.full((4, 4), np.nan)
    expected[:2, :2] = [[0.5, -0.5], [-0.5, 1.0]]
    np.testing.assert_allclose(covariance, expected, rtol=1e-12)


def test_what_shares_data_with_a_blind_pair_is_still_known():
    """The sum c + d is seen on its own and beside a: it takes a share of a's data.

    With s = c + d: rows a + s and s, so a = (first - second) has variance 2.
    """
    covariance = stated([[1.0, 1.0, 1.0], [0.0, 1.0, 1.0]])
    np.testing.assert_allclose(covariance[0, 0], 2.0, rtol=1e-12)
    assert np.isnan(covariance).sum() == 8


def test_parameter_without_any_effect_is_the_only_one_without_an_error():
    covariance = stated([[2.0, 0.0], [0.0, 0.0]])
    np.testing.assert_allclose(covariance, [[0.25, np.nan], [np.nan, np.nan]])


def test_fewer_data_than_parameters():
    """One number: of one parameter alone, or of a sum of two."""
    np.testing.assert_allclose(stated([[3.0, 0.0]])[0, 0], 1.0 / 9.0, rtol=1e-12)
    assert np.isnan(stated([[3.0, 0.0]])).sum() == 3
    assert np.isnan(stated([[3.0, 1.0]])).all()


def test_small_effect_is_no_blind_direction():
    """Parameters in other units: columns of 1e-2 and 1e9 are two clear signals."""
    covariance = stated(np.diag([1e-2, 1e9]))
    np.testing.assert_allclose(covariance, np.diag([1e4, 1e-18]), rtol=1e-12)


@pytest.mark.parametrize(("gap", "known"), [(1e-3, True), (1e-9, False)])
def test_only_rounding_counts_as_blind(gap, known):
    """Two columns that differ by a share `gap`: variances 1 + 1 / gap^2, 1 / gap^2."""
    covariance = stated([[1.0, 1.0], [0.0, gap]])
    if known:
        expected = [1.0 + gap**-2, gap**-2]
        np.testing.assert_allclose(np.diag(covariance), expected, rtol=1e-8)
    else:
        assert np.isnan(covariance).all()


def test_parameter_on_a_bound_is_held_and_the_others_know_it():
    """With b held, a's variance is 1/4 and not 1/2."""
    W = [[2.0, 1.0], [0.0, 1.0]]
    held = stated(W, [False, True])
    np.testing.assert_allclose(held, [[0.25, np.nan], [np.nan, np.nan]])
    assert np.isnan(stated(W, [True, True])).all()


def test_blind_direction_through_a_bound_is_seen():
    """c + d only, but d is held: c is determined."""
    covariance = stated([[3.0, 3.0]], [False, True])
    np.testing.assert_allclose(covariance[0, 0], 1.0 / 9.0, rtol=1e-12)


def test_estimated_noise_scales_the_covariance():
    """Ten coordinates, three parameters, one held: s^2 = 40 / (10 - 2)."""
    W = np.zeros((10, 3))
    W[:3] = np.diag([1.0, 2.0, 4.0])
    error = np.full(10, 2.0)
    held = np.array([False, False, True])
    spread = uncertainty(linear(W, held, error), "estimated")
    assert spread.degrees_of_freedom == 8
    assert spread.chi_squared == pytest.approx(40.0)
    assert spread.noise_scale == pytest.approx(np.sqrt(5.0))
    np.testing.assert_allclose(np.diag(spread.covariance)[:2], [5.0, 1.25])
    as_stated = uncertainty(linear(W, held, error), "stated")
    assert as_stated.noise_scale == 1.0
    np.testing.assert_allclose(np.diag(as_stated.covariance)[:2], [1.0, 0.25])


def test_no_degree_of_freedom_no_estimated_noise():
    spread = uncertainty(linear(np.eye(2), r=np.ones(2)), "estimated")
    assert spread.degrees_of_freedom == 0
    assert np.isnan(spread.noise_scale)
    assert np.isnan(spread.covariance).all()


def test_correlation_of_what_is_known():
    W = np.array([[2.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    spread = uncertainty(linear(W), "stated")
    correlation = spread.correlation
    np.testing.assert_allclose(correlation[0, 1], -np.sqrt(0.5), rtol=1e-12)
    np.testing.assert_allclose(np.diag(correlation)[:2], 1.0, rtol=1e-12)
    assert np.isnan(correlation[2]).all()
