import numpy as np
import pytest

from softcal_jax.identifiability import conditioning

RNG = np.random.default_rng(0)
W_EP = 1e-3 * RNG.normal(size=(12, 4))
WEIGHT = RNG.uniform(0.5, 2.0, (12, 1)) * 1e3
ROOT = RNG.normal(size=(4, 4))
W_PP = 1e-2 * ROOT @ ROOT.T


def test_condition_numbers_are_those_of_numpy():
    cond = conditioning(WEIGHT * W_EP, W_ep=W_EP, W_pp=W_PP)
    per_joule = np.linalg.cond(W_EP @ np.linalg.inv(W_PP))
    np.testing.assert_allclose(cond.condition_weighted, np.linalg.cond(WEIGHT * W_EP))
    np.testing.assert_allclose(cond.condition_W_ep, np.linalg.cond(W_EP))
    # The inverse loses the digits of its own condition number.
    np.testing.assert_allclose(
        cond.condition_W_ep_W_pp, per_joule, rtol=1e-14 * np.linalg.cond(W_PP)
    )
    # All three differ, or a mixed-up one would pass.
    assert abs(cond.condition_weighted / cond.condition_W_ep - 1.0) > 0.05
    assert abs(per_joule / cond.condition_W_ep - 1.0) > 0.05


def test_directions_are_eigenvectors_of_the_normal_matrix():
    W = WEIGHT * W_EP
    cond = conditioning(W)
    V, s = cond.directions, cond.singular_values
    np.testing.assert_allclose(V.T @ V, np.eye(4), atol=1e-14)
    np.testing.assert_allclose(W.T @ W @ V, V * s**2, atol=1e-12 * s[0] ** 2)
    assert np.all(np.diff(s) < 0)
    assert np.all(V.max(axis=0) >= -V.min(axis=0))  # the largest component is positive


def test_parameters_of_very_different_size_are_not_taken_for_blind():
    """W_pp of a modulus in Pa beside one in GPa has an inverse all the same."""
    S = np.array([1.0, 1e-9, 1e3, 1e-5])
    cond = conditioning(W_EP * S, W_ep=W_EP * S, W_pp=W_PP * np.outer(S, S))
    exact = np.linalg.cond((W_EP @ np.linalg.inv(W_PP)) / S)
    np.testing.assert_allclose(cond.condition_W_ep_W_pp, exact, rtol=1e-6)


@pytest.mark.parametrize(
    "W",
    [
        np.zeros((0, 4)),
        np.zeros((5, 4)),
        W_EP[:3],
        W_EP * np.array([1.0, 0.0, 1.0, 1.0]),
        W_EP[:, [0, 1, 2, 2]],
        np.outer(W_EP[:, 0], [1.0, 2.0, 3.0, 4.0]),
    ],
    ids=["no data", "all zero", "few data", "zero column", "twins", "rank one"],
)
def test_without_full_rank_the_condition_is_infinite(W):
    cond = conditioning(W, W_ep=W, W_pp=W_PP)
    assert cond.condition_weighted == np.inf
    assert cond.condition_W_ep == np.inf
    assert cond.condition_W_ep_W_pp == np.inf
    assert cond.singular_values.shape == (4,)
    np.testing.assert_allclose(
        cond.directions.T @ cond.directions, np.eye(4), atol=1e-14
    )
    assert "nan" not in str(cond)


@pytest.mark.parametrize(
    "W_pp", [np.zeros((4, 4)), np.ones((4, 4)), np.diag([1.0, 1.0, 1.0, 0.0])]
)
def test_w_pp_without_an_inverse_leaves_the_other_numbers(W_pp):
    cond = conditioning(W_EP, W_ep=W_EP, W_pp=W_pp)
    assert cond.condition_W_ep_W_pp == np.inf
    assert np.isfinite(cond.condition_W_ep)


def test_one_parameter_has_condition_one():
    cond = conditioning(W_EP[:, :1], W_ep=W_EP[:, :1], W_pp=W_PP[:1, :1])
    assert cond.condition_weighted == cond.condition_W_ep == 1.0
    assert cond.condition_W_ep_W_pp == 1.0
    assert cond.directions == np.ones((1, 1))


def test_what_is_not_given_is_not_shown():
    assert "W_pp" not in str(conditioning(W_EP))
    assert "W_pp" in str(conditioning(W_EP, W_ep=W_EP, W_pp=W_PP))


def test_a_failed_configuration_is_refused():
    with pytest.raises(ValueError, match="had no equilibrium"):
        conditioning(np.full((3, 2), np.nan))
