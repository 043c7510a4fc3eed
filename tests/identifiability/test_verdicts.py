"""Verdicts on compliances made by hand, whose answers are known in closed form."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from judged import angle, judge, modulus
from wording import says

from softcal_jax.equilibrium import build_model
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.identifiability import identifiability
from softcal_jax.inference import independent, uncertainty
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam


def test_a_product_is_seen_and_its_ratio_is_not():
    """Data of c ln(E a) only: 1/c for the product, nothing for the ratio."""
    c, asked = 200.0, 0.1
    outlook = judge([[c, c], [-c, -c]], modulus("E"), modulus("a"))
    assert outlook.verdict == "not identifiable"
    seen, blind = outlook.directions
    assert (seen.words, seen.verdict) == ("E and a up together", "identifiable")
    assert (blind.words, blind.verdict) == ("E up while a down", "not identifiable")
    assert outlook.blind == (blind,)
    # ln(E a) has the error 1 / (c root 2); half of it is the share of each.
    np.testing.assert_allclose(seen.ratio, 1.0 / (2.0 * c * np.sqrt(2.0)) / asked)
    assert blind.ratio == np.inf
    np.testing.assert_array_equal(np.diag(outlook.covariance), np.inf)
    assert all(p.standard_error == p.data_only == np.inf for p in outlook.parameters)
    assert outlook.conditioning.condition_weighted == np.inf


def test_the_blind_direction_is_in_units_of_what_is_asked():
    """W = (1, 1) with errors of 10 % and 0.05 asked for is blind along (1, -2)."""
    ratio = Parameter("nu", "nu", 0.3, 0.0, 0.5, scale="linear", S=1.0)
    mesh, law = beam(0.1, 0.02, 0.02, (1, 1, 1)), NeoHookean(1e5, 0.3)
    model = build_model(mesh, law, density=1e3, solver="none")
    blind = judge([[50.0, 50.0]], modulus(), ratio, model=model).directions[1]
    expected = np.array([-1.0, 2.0]) / np.sqrt(5.0)
    np.testing.assert_allclose(blind.components, expected, atol=1e-12)
    # The data see the modulus (share 0.8): the ratio is what is missing.
    assert blind.words == "nu up while E down"


def test_covariance_is_the_inverse_of_both_informations():
    W = np.random.default_rng(1).normal(size=(9, 3))
    prior = 0.7
    parameters = (
        modulus("E"),
        angle(S=0.1),
        replace(modulus("b", ratio=4.0), prior_std=jnp.asarray(prior)),
    )
    outlook = judge(W, *parameters)
    expected = np.linalg.inv(W.T @ W + np.diag([0.0, 0.0, prior**-2.0]))
    np.testing.assert_allclose(outlook.covariance, expected, rtol=1e-11)
    std = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        outlook.correlation, expected / np.outer(std, std), rtol=1e-11
    )
    # Moduli are logarithms, the angle is counted in units of S.
    in_si = std * np.array([1e5, 0.1, 1e5])
    errors = [p.standard_error for p in outlook.parameters]
    np.testing.assert_allclose(errors, in_si, rtol=1e-11)
    # 10 % of a modulus and 0.1 rad of an axis are asked for.
    np.testing.assert_allclose([p.asked for p in outlook.parameters], [1e4, 0.1, 1e4])
    np.testing.assert_allclose(
        [p.ratio for p in outlook.parameters], in_si / [1e4, 0.1, 1e4]
    )
    relative = [p.relative for p in outlook.parameters]
    assert relative == [pytest.approx(std[0]), None, pytest.approx(std[2])]
    assert [p.prior for p in outlook.parameters] == [None, None, pytest.approx(7e4)]
    # Without the prior, as the data alone would have it.
    alone = 1e5 * np.sqrt(np.linalg.inv(W.T @ W)[2, 2])
    assert outlook.parameters[2].data_only == pytest.approx(alone)


def test_data_alone_give_the_standard_errors_of_a_calibration():
    W = np.random.default_rng(2).normal(size=(9, 3)) * np.array([1e3, 1.0, 1e-4])
    outlook = judge(W, modulus("E"), modulus("a"), modulus("b"), noise_scale=1.7)
    errors = 1.7 * np.sqrt(9 - 3) * np.eye(9)[0]
    spread = uncertainty(independent(W, ("E", "a", "b"), r=errors), "estimated")
    assert spread.noise_scale == pytest.approx(1.7)
    expected = 1e5 * np.sqrt(np.diag(spread.covariance))
    np.testing.assert_allclose([p.data_only for p in outlook.parameters], expected)


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
    outlook = judge(W, modulus("E"), modulus("a"))
    assert np.isfinite(outlook.parameters[0].data_only)
    assert outlook.parameters[1].data_only == np.inf


@pytest.mark.parametrize("S", [0.01, 1.0, 7.0])
def test_the_scaling_of_a_parameter_decides_nothing(S):
    """W = S dy/dp: the same sensitivity in SI units, whatever unit is calibrated."""
    slope = np.array([[4.0], [3.0]])  # noise units per rad
    outlook = judge(S * slope, angle(S=S))
    np.testing.assert_allclose(outlook.parameters[0].standard_error, 1.0 / 5.0)
    np.testing.assert_allclose(outlook.parameters[0].asked, 0.1)
    assert outlook.verdict == "weakly identifiable"


def test_a_direction_is_judged_by_what_it_does_to_a_parameter():
    """Two moduli with errors of 9.9 % each, which are all but one error."""
    C = 0.099**2 * np.array([[1.0, -0.999], [-0.999, 1.0]])
    W = np.linalg.cholesky(np.linalg.inv(C)).T
    outlook = judge(W, modulus("E"), modulus("a"))
    assert [p.verdict for p in outlook.parameters] == ["identifiable"] * 2
    assert [d.verdict for d in outlook.directions] == ["identifiable"] * 2
    worst = outlook.directions[1]
    np.testing.assert_allclose(worst.ratio, 0.99 * np.sqrt(0.9995), rtol=1e-9)


def test_unseen_parameters_are_named_one_by_one():
    """Any turned basis of the unseen ones would be as good a null space."""
    W = np.random.default_rng(4).normal(size=(9, 5)) * 50.0
    W[:, [1, 3, 4]] = 1e-9 * W[:, [1, 3, 4]]
    outlook = judge(W, *(modulus(name) for name in "abcde"))
    assert {d.words for d in outlook.blind} == {"b", "d", "e"}
    vectors = np.stack([d.components for d in outlook.directions])
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(5), atol=1e-12)


def test_two_blind_ratios_are_told_apart():
    W = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]]) * 100.0
    outlook = judge(W, *(modulus(name) for name in "abcd"))
    words = {d.words for d in outlook.blind}
    assert words == {"a up while b down", "c up while d down"}


def test_blind_directions_that_overlap_stay_orthogonal():
    """Of a product of three, two ratios are blind: (2, -1, -1) and (0, 1, -1)."""
    outlook = judge([[100.0, 100.0, 100.0]], *(modulus(name) for name in "abc"))
    assert "leave 2 of 3 directions" in str(outlook)
    first, second = outlook.blind
    np.testing.assert_allclose(first.components, np.array([2, -1, -1]) / np.sqrt(6))
    np.testing.assert_allclose(
        second.components, np.array([0, 1, -1]) / np.sqrt(2), atol=1e-12
    )
    assert first.words == "a up while b and c down"
    assert second.words == "b up while c down"


def test_words():

    def words(v, names="abcdef"):
        """Of the one direction that the data do not see."""
        names = [name for name, _ in zip(names, v, strict=False)]
        across = np.eye(len(v)) - np.outer(v, v) / np.dot(v, v)
        (blind,) = judge(1e3 * across, *(modulus(name) for name in names)).blind
        return blind.words

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
    outlook = judge(W, modulus("E"), angle())
    assert outlook.verdict == ("identifiable" if case == "huge" else "not identifiable")
    assert len(outlook.directions) == 2
    vectors = np.stack([d.components for d in outlook.directions])
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(2), atol=1e-12)
    assert not np.any(np.isnan(np.diag(outlook.covariance)))
    assert "nan" not in str(outlook)
    assert "inf" not in str(outlook).split("Condition")[0]
    assert all(p.ratio >= 0.0 for p in outlook.parameters)
    assert outlook.n_data == int(np.any(W != 0, axis=1).sum())


def test_one_parameter():
    outlook = judge(np.zeros((4, 1)), modulus())
    assert outlook.directions[0].words == "E"
    assert "Not identifiable" in str(outlook)
    assert judge([[1e3]], modulus()).verdict == "identifiable"


def test_report_is_in_the_units_of_a_person():
    outlook = judge([[30.0, 0.0], [0.0, 0.0]], modulus("E"), angle("theta of CP 2"))
    text = str(outlook)
    assert says(text.splitlines()[0], "Not identifiable", "1 measured", "2 parameters")
    assert says(text, "100 kPa", "3.33 kPa (3.3 %)", "10 kPa", "identifiable")
    assert says(text, "17.19 deg", "blind", "5.73 deg", "not identifiable")
    assert "theta of CP 2 (blind)" in text
    assert says(text, "lack at least 1 measured coordinate")
    assert "softcal identify" in text
    assert "Bounds do not count as data." in text


def test_a_good_verdict_asks_for_nothing():
    text = str(judge(1e3 * np.eye(2), modulus("E"), angle()))
    assert text.startswith("Identifiable at these values")
    assert "Add a configuration" not in text
    assert "prior" not in text
    assert "undetermined" not in text


def test_many_blind_directions_are_counted():
    outlook = judge(np.zeros((1, 12)), *(modulus(f"p{i}") for i in range(12)))
    assert "and 4 more." in str(outlook)
    assert str(outlook).count("(blind)") == 8


def test_noise_scale_divides_the_signal():
    one = judge([[3.0]], modulus())
    two = judge([[6.0]], modulus(), noise_scale=2.0)
    np.testing.assert_array_equal(one.covariance, two.covariance)


@pytest.mark.usefixtures("unchecked")
def test_wrong_calls():
    with pytest.raises(ValueError, match=r"scale.*positive.*got 0"):
        judge([[1.0]], modulus(), noise_scale=0.0)
    with pytest.raises(ValueError, match="had no equilibrium"):
        judge([[np.nan]], modulus())


def test_a_device_array_does_for_z():
    space = ParameterSpace((modulus(),))
    linear = independent(np.ones((1, 1)), ("E",))
    host = identifiability(linear, space, np.asarray(space.start()))
    device = identifiability(linear, space, jnp.asarray(space.start()))
    assert str(host) == str(device)


def test_errors_that_are_considered_widen_the_covariance():
    """C + D D^T with D = C W^T W_c, in closed form."""
    random = np.random.default_rng(7)
    W, W_c = 10.0 * random.normal(size=(9, 3)), random.normal(size=(9, 2))
    weights = np.array([0.0, 2.0, 0.0])
    parameters = [modulus(name) for name in "abc"]
    parameters[1] = replace(parameters[1], prior_std=jnp.asarray(0.5))
    C = np.linalg.inv(W.T @ W + np.diag(weights**2))
    D = C @ W.T @ W_c
    outlook = judge(W, *parameters, W_c=W_c)
    np.testing.assert_allclose(outlook.covariance, C + D @ D.T, rtol=1e-10)


def test_what_the_data_alone_tell_is_what_they_tell_without_a_prior():
    random = np.random.default_rng(8)
    W, W_c = random.normal(size=(9, 3)), random.normal(size=(9, 2))
    parameters = [modulus(name) for name in "abc"]
    alone = judge(W, *parameters, W_c=W_c)
    parameters[1] = replace(parameters[1], prior_std=jnp.asarray(0.5))
    informed = judge(W, *parameters, W_c=W_c)
    expected = [p.standard_error for p in alone.parameters]
    data_only = [p.data_only for p in informed.parameters]
    np.testing.assert_allclose(data_only, expected, rtol=1e-9)
    assert informed.parameters[1].standard_error < 0.9 * expected[1]


def test_the_principal_errors_of_a_covariance_are_the_directions():
    """Eigenvalues of C + D D^T in units of what is asked."""
    random = np.random.default_rng(9)
    W, W_c = 100.0 * random.normal(size=(9, 3)), 30.0 * random.normal(size=(9, 2))
    outlook = judge(W, *(modulus(name) for name in "abc"), W_c=W_c)
    variance, V = np.linalg.eigh(outlook.covariance / 0.1**2)
    expected = np.sqrt(variance) * np.max(np.abs(V), axis=0)
    np.testing.assert_allclose(
        [d.ratio for d in outlook.directions], np.sort(expected), rtol=1e-9
    )
