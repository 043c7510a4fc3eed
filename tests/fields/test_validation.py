"""Parameters against the model that they are to calibrate."""

import numpy as np
import pytest

from softcal_jax.equilibrium import build_model
from softcal_jax.fields import Parameter, ParameterSpace, check_parameters
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import beam

MESH = (
    beam(1.0, 0.5, 0.5, (2, 1, 1))
    .with_tet_group("near", np.arange(6))
    .with_tet_group("far", np.arange(6, 12))
    .with_tet_group("middle", np.arange(4, 8))
)


def model(E=2e5):
    return build_model(MESH, Corotational(Isotropic(E, 0.3)), density=1000.0)


def modulus(name, region=None):
    return Parameter(name, "E", 2e5, 1e5, 1e6, region=region)


def check(body, *parameters):
    check_parameters(body, ParameterSpace(parameters))


def test_regions_side_by_side_are_fine():
    check(model(), modulus("a", "near"), modulus("b", "far"))


def test_whole_body_must_not_flatten_its_regions():
    stiff_tip = np.where(np.arange(12) < 6, 3e5, 3e6)
    with pytest.raises(ValueError, match=r"between 300000 and 3e\+06.*`region`"):
        check(model(stiff_tip), modulus("E"))
    check(model(stiff_tip), modulus("E", "far"))


@pytest.mark.parametrize("regions", [("near", "middle"), (None, "far"), (None, None)])
def test_two_parameters_must_not_set_the_same_tets(regions):
    with pytest.raises(ValueError, match="'a' and 'b' both set E of tet"):
        check(model(), modulus("a", regions[0]), modulus("b", regions[1]))


def test_unknown_region_is_named():
    with pytest.raises(ValueError, match="'nowhere'"):
        check(model(), modulus("E", "nowhere"))


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        (("nu", 0.3, 0.1, 0.6), r"upper bound: nu must lie in \(-1, 0.5\), got 0.6"),
        (("E", 1e5, -1.0, 1e6), "lower bound: E must be positive"),
        (("density", 1e3, -1.0, 1e4), "lower bound: density must not be negative"),
    ],
)
def test_bounds_outside_the_range_of_the_material(parameter, message):
    field, start, lower, upper = parameter
    wide = Parameter(field, field, start, lower, upper, scale="linear")
    with pytest.raises(ValueError, match=message):
        check(model(), wide)
