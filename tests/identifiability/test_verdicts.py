"""Verdicts on compliances made by hand, whose answers are known in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest

from softcal_jax.calibration import uncertainty
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.identifiability import identifiability
from softcal_jax.identifiability._spread import direction_words, marginalised

ROOT_12 = np.sqrt(12.0)


def modulus(name="E", start=1e5, ratio=100.0):
    """A modulus whose bounds are a ratio apart, with the start in their middle."""
    half = np.sqrt(ratio)
    return Parameter(name, name, start, start / half, start * half, unit="Pa")


def angle(name="theta", half_width=np.pi / 2, S=None):
    return Parameter(
        name, name, 0.3, -half_width, half_width, scale="linear", S=S, unit="rad"
    )


def judge(W, *parameters, **keywords):
    space = ParameterSpace(parameters)
    return identifiability(np.array(W, float), space, space.start(), **keywords)


def test_a_product_is_seen_and_its_ratio_is_not():
    """Data of c ln(E a) only: 1/c for the product, the bounds' width for the ratio."""
    c, prior = 200.0, np.log(100.0) / ROOT_12
    found = judge([[c, c], [-c, -c]], modulus("E"), modulus("a"))
    assert found.verdict == "not identifiable"
    seen, blind = found.directions
    assert (seen.words, seen.verdict) == ("E and a up together", "identifiable")
    assert (blind.words, blind.verdict) == ("E up while a down", "not identifiable")
    assert found.blind == (blind,)
    np.testing.assert_allclose(seen.signal, 2.0 * c * prior, rtol=1e-12)
    assert blind.spread == pytest.approx(1.0)
    # Each is half the sum (known) and half the difference (the prior's).
    variance = 0.5 * prior**2 * (1.0 + 1.0 / (1.0 + seen.signal**2))
    np.testing.assert_allclose(np.diag(found.covariance), variance, rtol=1e-12)
    assert found.correlation[0, 1] < -0.999
    assert all(p.data_only == np.inf for p in found.parameters)
    assert found.conditioning.condition_weighted == np.inf


def test_the_blind_direction_of_unequal_bounds_is_in_units_of_the_bounds():
    """W = (1, 1) with priors 2 : 1 is blind along (-1, 2), not (-1, 1)."""
    wide = modulus("wide", ratio=1e4)
    narrow = modulus("narrow", ratio=1e2)
    blind = judge([[50.0, 50.0]], wide, narrow).directions[1]
    expected = np.array([-1.0, 2.0]) / np.sqrt(5.0)
    np.testing.assert_allclose(blind.components, expected, atol=1e-12)
    # The data see the wide one (share 0.8): the narrow one is what is missing.
    assert blind.words == "narrow up while wide down"


def test_covariance_is_the_inverse_of_both_informations():
    W = np.random.default_rng(1).normal(size=(9, 3))
    parameters = (modulus("E"), angle(S=0.1), modulus("b", ratio=4.0))
    found = judge(W, *parameters)
    prior = np.array([np.log(100.0), np.pi / 0.1, np.log(4.0)]) / ROOT_12
    expected = np.linalg.inv(W.T @ W + np.diag(prior**-2.0))
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-11)
    std = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found.correlation, expected / np.outer(std, std), rtol=1e-11
    )
    # Moduli are logarithms, the angle is counted in units of S.
    in_si = std * np.array([1e5, 0.1, 1e5])
    errors = [p.standard_error for p in found.parameters]
    np.testing.assert_allclose(errors, in_si, rtol=1e-11)
    np.testing.assert_allclose([p.spread for p in found.parameters], std / prior)
    relative = [p.relative for p in found.parameters]
    assert relative == [pytest.approx(std[0]), None, pytest.approx(std[2])]


def test_data_alone_give_the_standard_errors_of_a_calibration():
    W = np.random.default_rng(2).normal(size=(9, 3)) * np.array([1e3, 1.0, 1e-4])
    found = judge(W, modulus("E"), modulus("a"), modulus("b"), noise_scale=1.7)
    errors = 1.7 * np.sqrt(9 - 3) * np.eye(9)[0]
    spread = uncertainty(W, errors, 9, np.zeros(3, bool), "estimated")
    assert spread.noise_scale == pytest.approx(1.7)
    expected = 1e5 * np.sqrt(np.diag(spread.covariance))
    np.testing.assert_allclose([p.data_only for p in found.parameters], expected)


def test_only_parameters_of_a_blind_direction_lack_an_error_of_their_own():
    W = np.random.default_rng(3).normal(size=(9, 4))
    W[:, 3], W[:, 2] = 0.0, 2.0 * W[:, 1]
    names = [modulus(name) for name in "abcd"]
    alone = np.array([p.data_only for p in judge(W, *names).parameters])
    np.testing.assert_array_equal(np.isfinite(alone), [True, False, False, False])
    pair = W[:, :2]
    expected = 1e5 * np.sqrt(np.linalg.inv(pair.T @ pair)[0, 0])
    np.testing.assert_allclose(alone[0], expected, rtol=1e-10)


def test_rounding_does_not_pass_for_a_sensitivity():
    """A column of 1e-14 of the other is what a factorization leaves of a zero."""
    W = np.random.default_rng(5).normal(size=(9, 2)) * np.array([1.0, 1e-14])
    found = judge(W, modulus("E"), modulus("a"))
    assert np.isfinite(found.parameters[0].data_only)
    assert found.parameters[1].data_only == np.inf


@pytest.mark.parametrize(
    ("spread", "expected"),
    [
        (0.0999, "identifiable"),
        (0.1001, "weakly identifiable"),
        (0.4999, "weakly identifiable"),
        (0.5001, "not identifiable"),
    ],
)
def test_thresholds(spread, expected):
    """Signal to noise per prior standard deviation that leaves a given spread."""
    signal = np.sqrt(1.0 / spread**2 - 1.0)
    found = judge([[signal * ROOT_12 / np.log(100.0)]], modulus())
    assert found.verdict == found.parameters[0].verdict == expected
    assert found.parameters[0].spread == pytest.approx(spread, rel=1e-9)


@pytest.mark.parametrize("S", [0.01, 1.0, 7.0])
def test_the_scaling_of_a_parameter_decides_nothing(S):
    """W = S dy/dp: the same sensitivity in SI units, whatever unit is calibrated."""
    slope = np.array([[4.0], [3.0]])  # noise units per rad
    found = judge(S * slope, angle(S=S))
    prior = np.pi / ROOT_12
    error = 1.0 / np.sqrt(25.0 + prior**-2)
    np.testing.assert_allclose(found.parameters[0].standard_error, error)
    np.testing.assert_allclose(found.parameters[0].prior, prior)
    np.testing.assert_allclose(found.parameters[0].data_only, 1.0 / 5.0)


def test_unseen_parameters_are_named_one_by_one():
    """Any turned basis of the unseen ones would be as good a null space."""
    W = np.random.default_rng(4).normal(size=(9, 5)) * 50.0
    W[:, [1, 3, 4]] = 1e-9 * W[:, [1, 3, 4]]
    found = judge(W, *(modulus(name) for name in "abcde"))
    assert {d.words for d in found.blind} == {"b", "d", "e"}
    vectors = np.stack([d.components for d in found.directions])
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(5), atol=1e-12)


def test_two_blind_ratios_are_told_apart():
    W = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]]) * 100.0
    found = judge(W, *(modulus(name) for name in "abcd"))
    words = {d.words for d in found.blind}
    assert words == {"a up while b down", "c up while d down"}


def test_blind_directions_that_overlap_stay_orthogonal():
    """Of a product of three, two ratios are blind: (2, -1, -1) and (0, 1, -1)."""
    found = judge([[100.0, 100.0, 100.0]], *(modulus(name) for name in "abc"))
    assert "hardly see 2 of 3 directions" in str(found)
    first, second = found.blind
    np.testing.assert_allclose(first.components, np.array([2, -1, -1]) / np.sqrt(6))
    np.testing.assert_allclose(
        second.components, np.array([0, 1, -1]) / np.sqrt(2), atol=1e-12
    )
    assert first.words == "a up while b and c down"
    assert second.words == "b up while c down"


def test_words():
    words = lambda v, names="abcdef": direction_words(np.array(v), list(names))
    assert words([0.0, -1.0]) == "b"
    assert words([0.1, 0.995]) == "b"  # a share of 0.01 is not named
    assert words([-0.6, 0.8]) == "b up while a down"
    assert words([0.6, 0.8]) == "b and a up together"
    assert words([0.6, 0.6, -0.53]) == "a and b up while c down"
    even = np.full(36, 1.0 / 6.0)
    assert words(even, [f"p{i}" for i in range(36)]) == (
        "p0, p1, p2 and p3 and 32 more up together"
    )


CASES = {
    "nothing measured": np.zeros((0, 2)),
    "only zeros": np.zeros((3, 2)),
    "fewer data than parameters": np.array([[3.0, 1.0]]),
    "zero column": np.array([[3.0, 0.0], [1.0, 0.0], [2.0, 0.0]]),
    "huge": 1e100 * np.eye(2),
    "tiny": 1e-200 * np.eye(2),
    "huge beside tiny": np.diag([1e12, 1e-12]),
}


@pytest.mark.parametrize("case", CASES)
def test_whatever_the_data_there_is_a_verdict_without_nan(case):
    W = CASES[case]
    found = judge(W, modulus("E"), angle())
    assert found.verdict == ("identifiable" if case == "huge" else "not identifiable")
    assert np.all(np.isfinite(found.covariance))
    assert np.all(np.isfinite(found.correlation))
    assert "nan" not in str(found)
    assert all(0.0 <= p.spread <= 1.0 + 1e-12 for p in found.parameters)
    assert found.n_data == int(np.any(W != 0, axis=1).sum())


def test_one_parameter():
    found = judge(np.zeros((4, 1)), modulus())
    assert found.directions[0].words == "E"
    assert "Not identifiable" in str(found)
    assert judge([[1e3]], modulus()).verdict == "identifiable"


def test_report_is_in_the_units_of_a_person():
    found = judge([[30.0, 0.0], [0.0, 0.0]], modulus("E"), angle("theta of CP 2"))
    text = str(found)
    lines = text.splitlines()
    first = "Not identifiable at these values: 1 measured coordinate for 2 parameters."
    assert lines[0] == first
    assert "100 kPa    3.33 kPa (3.3 %)" in text
    # The bounds of 180 degrees leave 180 / root 12 = 52 degrees.
    assert "17.19 deg  52 deg" in text
    assert "theta of CP 2 (100 %)" in text
    assert "At least 1 more measured coordinate is needed." in text
    assert "ranking candidates" in text
    assert "takes the bounds for knowledge" in text


def test_a_good_verdict_asks_for_nothing():
    text = str(judge(1e3 * np.eye(2), modulus("E"), angle()))
    assert text.startswith("Identifiable at these values")
    assert "What to do" not in text
    assert "knowledge" not in text  # the bounds hardly count
    assert "hardly see" not in text


def test_many_blind_directions_are_counted():
    found = judge(np.zeros((1, 12)), *(modulus(f"p{i}") for i in range(12)))
    assert "and 4 more." in str(found)
    assert str(found).count("(100 %)") == 8


def test_noise_scale_divides_the_signal():
    one = judge([[3.0]], modulus())
    two = judge([[6.0]], modulus(), noise_scale=2.0)
    np.testing.assert_array_equal(one.covariance, two.covariance)


@pytest.mark.usefixtures("unchecked")
def test_wrong_calls():
    with pytest.raises(ValueError, match="one column for each of the 1 parameters"):
        judge(np.zeros((3, 2)), modulus())
    with pytest.raises(ValueError, match="noise_scale must be positive, got 0"):
        judge([[1.0]], modulus(), noise_scale=0.0)
    with pytest.raises(ValueError, match="had no equilibrium"):
        judge([[np.nan]], modulus())


def test_a_device_array_does_for_z():
    space = ParameterSpace((modulus(),))
    W = np.ones((1, 1))
    host = identifiability(W, space, np.asarray(space.start()))
    device = identifiability(W, space, jnp.asarray(space.start()))
    assert str(host) == str(device)


def test_errors_that_are_considered_widen_the_covariance():
    """(I + R^T R)^-1 is C + D D^T, for errors that leave it below the prior's."""
    random = np.random.default_rng(7)
    G, W_c = 10.0 * random.normal(size=(9, 3)), random.normal(size=(9, 2))
    C = np.linalg.inv(np.eye(3) + G.T @ G)
    D = C @ G.T @ W_c
    R = marginalised(G, W_c)
    np.testing.assert_allclose(
        np.linalg.inv(np.eye(3) + R.T @ R), C + D @ D.T, rtol=1e-10, atol=1e-12
    )


def test_errors_cannot_make_data_worse_than_none():
    """What would be off by more than the prior allows is not told at all."""
    R = marginalised(np.array([[3.0, 0.0], [0.0, 100.0]]), np.array([[50.0], [0.0]]))
    variance = np.diag(np.linalg.inv(np.eye(2) + R.T @ R))
    np.testing.assert_allclose(variance, [1.0, 1.0 / (1.0 + 1e4)], rtol=1e-9)
