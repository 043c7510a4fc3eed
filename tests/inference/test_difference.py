"""What two robots give for one material, against closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2
from wording import says

from softcal_jax.fields import Parameter, ParameterSpace, load_factor
from softcal_jax.inference import Estimate, difference
from softcal_jax.results import headline


def space(scale="log", start=1e5):
    E = Parameter("E", "E", start, 1e4, 1e6, scale=scale, unit="Pa")
    nu = Parameter("nu", "nu", 0.3, 0.0, 0.49, scale="linear")
    return ParameterSpace((E, nu))


def estimate(E, std_E, nu, std_nu, rho=0.0, **more):
    """An estimate with standard errors in SI and a correlation."""
    one = space(**more)
    z = np.asarray(one.to_scaled(jnp.array([E, nu])))
    std = np.array([std_E, std_nu]) / one.slopes(z)
    C = np.outer(std, std) * np.array([[1.0, rho], [rho, 1.0]])
    return Estimate(one, z, C)


def test_differences_add_their_variances():
    """Whatever scale, start and step each space has."""
    a = estimate(1e5, 300.0, 0.3, 0.003)
    b = estimate(1.005e5, 400.0, 0.295, 0.004, scale="linear", start=3e5)
    found = difference(a, b)
    assert found.names == ("E", "nu")
    np.testing.assert_allclose(found.of_a, [1e5, 0.3], rtol=1e-12)
    np.testing.assert_allclose(found.of_b, [1.005e5, 0.295], rtol=1e-12)
    np.testing.assert_allclose(found.std_a, [300.0, 0.003], rtol=1e-12)
    np.testing.assert_allclose(found.std_b, [400.0, 0.004], rtol=1e-12)
    np.testing.assert_allclose(found.unseen, [1000.0, 0.01], rtol=1e-12)
    assert found.chi_squared == pytest.approx(1.0 + 1.0, rel=1e-10)
    assert found.probability == pytest.approx(chi2.sf(2.0, 2), rel=1e-10)
    assert found.agree
    assert says(headline(found), "agree within their errors", "2 for 2", "material")


def test_a_direction_in_which_both_are_sure_tells_them_apart():
    """Each value alone agrees; E and nu together, by their correlation, do not."""
    a = estimate(1e5, 3e3, 0.3, 0.03, rho=0.999, scale="linear")
    b = estimate(1.02e5, 3e3, 0.28, 0.03, rho=0.999, scale="linear")
    found = difference(a, b)
    C = 2.0 * np.outer([3e3, 0.03], [3e3, 0.03]) * [[1.0, 0.999], [0.999, 1.0]]
    d = np.array([2e3, -0.02])
    assert found.chi_squared == pytest.approx(d @ np.linalg.solve(C, d), rel=1e-8)
    assert not found.agree
    assert found.worst_size == pytest.approx(np.sqrt(found.chi_squared), rel=1e-3)
    np.testing.assert_allclose(found.worst, d, rtol=0.05)
    assert says(headline(found), "do not agree", "E by 2 kPa", "nu by -0.02")


def test_what_only_one_knows_is_left_out():
    a = estimate(1e5, 300.0, 0.3, 0.03)
    blind = a._replace(covariance=np.array([[np.nan, np.nan], [np.nan, 1e-4]]))
    assert difference(blind, a).names == ("nu",)


def test_parameters_of_the_setup_are_of_one_robot_each():
    factor = ParameterSpace((load_factor("pull", prior_std=0.1),))
    one = Estimate(factor, np.zeros(1), np.eye(1))
    with pytest.raises(ValueError, match="no parameter of the material"):
        difference(one, one)


def test_agreement_that_says_little_is_not_praised():
    a = estimate(1e5, 2e4, 0.3, 0.01)
    found = difference(a, estimate(1.1e5, 2e4, 0.3, 0.01))
    assert found.agree
    assert says(headline(found), "agree", "could hide", "E by 57 kPa")
    assert "material" not in headline(found)


def test_parameters_that_vary_together_count_once():
    a = estimate(1e5, 300.0, 0.3, 0.003, rho=1.0, scale="linear")
    b = estimate(1.006e5, 300.0, 0.306, 0.003, rho=1.0, scale="linear")
    found = difference(a, b)
    assert found.directions == 1
    assert found.chi_squared == pytest.approx(2.0, rel=1e-6)
    assert found.probability == pytest.approx(chi2.sf(2.0, 1), rel=1e-6)


def test_a_robot_that_its_own_fit_contradicts_agrees_with_none():
    """However near its values are: they make up for something else."""
    a = estimate(1e5, 300.0, 0.3, 0.003)
    wrong = a._replace(contradicted=True)
    assert difference(a, a).agree
    for one, other, names in (
        (wrong, a, "A"),
        (a, wrong, "B"),
        (wrong, wrong, "A and B"),
    ):
        found = difference(one, other)
        assert found.probability == 1.0
        assert not found.agree
        assert says(headline(found), f"contradicts the data of {names}:", "shape")
