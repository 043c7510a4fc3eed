import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softcal_jax.materials import Isotropic, NeoHookean, lame

each_class = pytest.mark.parametrize("law", [Isotropic, NeoHookean])


def test_lame_constants():
    lam, mu = lame(jnp.asarray(5.0), jnp.asarray(0.25))
    np.testing.assert_allclose([lam, mu], [2.0, 2.0], rtol=1e-15)


@each_class
@pytest.mark.parametrize("E", [0.0, -1e5, np.nan, np.inf])
def test_bad_modulus(law, E):
    with pytest.raises(ValueError, match=rf"^E .*positive .*\[Pa\], got {E:g}\."):
        law(E, 0.3)


@each_class
def test_bad_modulus_of_one_tet_is_shown(law):
    for bad in (-3.0, np.inf, np.nan):
        with pytest.raises(ValueError, match=rf"^E .*\[Pa\], got {bad:g}\."):
            law(np.array([2e5, bad, 1e5]), 0.3)


@each_class
@pytest.mark.parametrize("nu", [-1.0, 0.5, 0.7, -2.0, np.nan])
def test_bad_poisson_ratio(law, nu):
    with pytest.raises(ValueError, match=rf"nu .*\(-1, 0\.5\), got {nu:g}\."):
        law(1e5, nu)


@each_class
def test_incompressible_rubber_gets_a_hint(law):
    with pytest.raises(ValueError, match=r"got 0\.5\. .*rubber .* 0\.499"):
        law(1e5, np.array([0.3, 0.5]))


@each_class
def test_the_whole_range_is_taken(law):
    for nu in (-0.999, 0.0, 0.499):
        assert float(law(1e5, nu).nu) == nu


@each_class
def test_constants_may_be_traced(law):
    """The checks look at concrete values only; a gradient goes through."""
    slope = jax.grad(lambda E: jnp.sum(law(E, 0.3).stress(1.1 * jnp.eye(3))))(2.0)
    total = jnp.sum(law(2.0, 0.3).stress(1.1 * jnp.eye(3)))
    # Both are proportional to E.
    np.testing.assert_allclose(slope, total / 2.0, rtol=1e-14)
