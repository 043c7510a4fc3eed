"""Restricted maximum likelihood against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from softcal_jax.inference import freedom_between, independent, restricted_likelihood


def errors(r, W):
    return independent(W, tuple("abc"[: W.shape[1]]), r=r)


def one_way(seed, between, groups=6, members=5):
    """A balanced one-way layout: its errors, and what each group shares."""
    random = np.random.default_rng(seed)
    of_groups = between * random.standard_normal((groups, 1))
    y = of_groups + random.standard_normal((groups, members))
    shared = np.kron(np.eye(groups), np.ones((members, 1)))
    return y, errors(y.ravel(), np.ones((y.size, 1))), shared


@pytest.mark.parametrize(("seed", "between"), [(0, 2.0), (3, 0.7)])
def test_a_balanced_one_way_layout_gives_the_analysis_of_variance(seed, between):
    """Searle, Casella and McCulloch, Variance Components, 1992, sec. 3.8."""
    y, linear, shared = one_way(seed, between)
    groups, members = y.shape
    mean = y.mean(axis=1, keepdims=True)
    within = np.sum((y - mean) ** 2) / (groups * (members - 1))
    among = members * np.var(mean, ddof=1)
    assert among > within
    expected = np.sqrt([within, (among - within) / members])
    both = restricted_likelihood(linear, [shared], [1.0, 1.0], [True, True])
    np.testing.assert_allclose(both, expected, rtol=1e-6)
    # From a first value that is far off as well.
    far = restricted_likelihood(linear, [shared], [1.0, 30.0], [True, True])
    np.testing.assert_allclose(far, expected, rtol=1e-6)


def test_groups_that_differ_less_than_their_members_show_nothing():
    """The analysis of variance has a negative variance: zero is most likely.

    Then all is one sample, with the variance over n - p degrees of freedom.
    """
    y, _, shared = one_way(0, 0.0)
    y = y - y.mean(axis=1, keepdims=True) + 0.01 * np.arange(len(y))[:, None]
    linear = errors(y.ravel(), np.ones((y.size, 1)))
    both = restricted_likelihood(linear, [shared], [1.0, 1.0], [True, True])
    np.testing.assert_allclose(both, [np.std(y, ddof=1), 0.0], rtol=1e-6)


def test_without_columns_it_is_the_mean_square():
    random = np.random.default_rng(1)
    r, W = random.standard_normal(12), random.standard_normal((12, 3))
    r = r - W @ np.linalg.lstsq(W, r)[0]
    (scale,) = restricted_likelihood(errors(r, W), [], [1.0], [True])
    np.testing.assert_allclose(scale, np.sqrt(r @ r / 9), rtol=1e-8)


def test_a_prior_takes_part_of_a_degree_of_freedom():
    """One parameter, seen by n values of the same size: a scalar equation.

    In the mean y/n the variance is s^2/n + tau^2, in the other n - 1 directions s^2.
    """
    random = np.random.default_rng(2)
    n, tau = 8, 0.5
    r = 0.3 + random.standard_normal(n)
    linear = replace(errors(r, np.ones((n, 1))), prior_weights=np.array([1.0 / tau]))
    (scale,) = restricted_likelihood(linear, [], [1.0], [True])
    s = scale * np.exp(np.array([-1e-4, 0.0, 1e-4]))
    total = s**2 / n + tau**2
    rest = np.sum((r - r.mean()) ** 2)
    likelihood = (n - 1) * np.log(s**2) + rest / s**2
    likelihood += np.log(total) + r.mean() ** 2 / total
    assert likelihood[1] == min(likelihood)


def test_what_is_stated_stays():
    _, linear, shared = one_way(0, 2.0)
    stated = restricted_likelihood(linear, [shared], [1.3, 0.4], [False, True])
    assert stated[0] == 1.3
    stated = restricted_likelihood(linear, [shared], [1.3, 0.4], [True, False])
    assert stated[1] == 0.4


def test_degrees_of_freedom_are_those_of_the_layout():
    _, linear, shared = one_way(0, 1.0)
    assert freedom_between(linear, shared) == (5, 24)
