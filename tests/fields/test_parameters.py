import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softcal_jax.equilibrium import build_model
from softcal_jax.fields import Parameter, ParameterSpace, find_field
from softcal_jax.materials import Corotational, Isotropic, NeoHookean
from softcal_jax.mesh import beam


@pytest.fixture(scope="module")
def model():
    mesh = beam(1.0, 0.5, 0.5, (2, 1, 1)).with_tet_group("tip", np.arange(6, 12))
    return build_model(mesh, Corotational(Isotropic(2e5, 0.3)), density=1000.0)


def test_log_scale_steps_are_ratios():
    space = ParameterSpace((Parameter("E", "E", 2e5, 1e5, 1e6),))
    moved = space.from_scaled(space.start() + jnp.log(2.0))
    np.testing.assert_allclose(moved, [4e5], rtol=1e-14)


def test_linear_scale_steps_by_S_or_by_the_range():
    ranged = Parameter("nu", "nu", 0.3, 0.1, 0.4, scale="linear")
    stated = Parameter("E", "E", 2e5, 1e5, 1e6, scale="linear", S=1e6)
    space = ParameterSpace((ranged, stated))
    step = space.from_scaled(space.start() + 0.1) - space.from_scaled(space.start())
    np.testing.assert_allclose(step, [0.03, 1e5], rtol=1e-12)


def test_apply_sets_the_field_of_the_whole_body(model):
    space = ParameterSpace((Parameter("E", "E", 2e5, 1e5, 1e6),))
    changed = space.model_at(model, jnp.log(jnp.array([5e5])))
    np.testing.assert_allclose(changed.law.elasticity.E, 5e5, rtol=1e-14)
    np.testing.assert_array_equal(changed.law.elasticity.nu, 0.3)


def test_apply_sets_a_region_and_leaves_the_rest(model):
    space = ParameterSpace(
        (Parameter("rho", "density", 900.0, 1.0, 5e3, region="tip", unit="kg/m3"),)
    )
    density = np.asarray(space.model_at(model, space.start()).density)
    np.testing.assert_allclose(density[6:], 900.0, rtol=1e-14)
    np.testing.assert_array_equal(density[:6], 1000.0)


def test_apply_passes_derivatives_to_every_parameter(model):
    space = ParameterSpace(
        (
            Parameter("E", "E", 2e5, 1e5, 1e6),
            Parameter("nu", "nu", 0.3, 0.0, 0.4, scale="linear", S=2.0),
            Parameter("rho", "density", 1e3, 1.0, 5e3, scale="linear", S=10.0),
        )
    )

    def fields(z):
        changed = space.model_at(model, z)
        law = changed.law.elasticity
        return jnp.stack([law.E, law.nu, changed.density])

    slope = jax.jacfwd(fields)(space.start())
    np.testing.assert_allclose(slope, np.diag([2e5, 2.0, 10.0]), rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"lower": 1e6, "upper": 1e5}, r"crossed.* lower 1e\+06 .* 100000"),
        ({"start": 2e6}, r"start 2e\+06, .* 100000 .* 1e\+06"),
        ({"start": np.nan}, "finite.* start nan"),
        ({"lower": -1.0}, "-1.*linear"),
        ({"scale": "linear", "S": 0.0}, "S .*positive .* got 0; leave"),
        ({"scale": "ln"}, "scale is 'ln', .*linear"),
    ],
)
def test_bad_parameter_names_value_and_remedy(unchecked, changes, message):
    good = {"start": 2e5, "lower": 1e5, "upper": 1e6}
    with pytest.raises(ValueError, match=f"'E': .*{message}"):
        Parameter("E", "E", **(good | changes))


def test_space_refuses_no_parameters_and_repeated_names():
    one = Parameter("E", "E", 2e5, 1e5, 1e6)
    with pytest.raises(ValueError, match="at least one parameter"):
        ParameterSpace(())
    with pytest.raises(ValueError, match=r"'E' .*more than once"):
        ParameterSpace((one, one))


def test_unknown_field_lists_those_there_are(model):
    with pytest.raises(ValueError, match=r"'Young' .*law.elasticity.E, .*density"):
        find_field(model, "Young")


def test_field_of_a_law_is_found_at_any_depth(model):
    other = build_model(model.mesh, NeoHookean(3e5, 0.4), density=1.0)
    assert float(find_field(model, "E")(model)) == 2e5
    assert float(find_field(other, "E")(other)) == 3e5
