"""Parameters against the model that they are to calibrate."""

import numpy as np
import pytest

from softcal_jax.equilibrium import build_model
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    Parameter,
    ParameterSpace,
    check_parameters,
)
from softcal_jax.materials import (
    Corotational,
    Fibre,
    Isotropic,
    ReducedTransverseIsotropic,
)
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
    with pytest.raises(ValueError, match=r"'a' and 'b' .* E of .*regions"):
        check(model(), modulus("a", regions[0]), modulus("b", regions[1]))


def test_unknown_region_is_named():
    with pytest.raises(ValueError, match="'nowhere'"):
        check(model(), modulus("E", "nowhere"))


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        (("nu", 0.3, 0.1, 0.6), r"upper bound: nu .*\(-1, 0\.5\), got 0\.6"),
        (("E", 1e5, -1.0, 1e6), "lower bound: E .*positive.* -1"),
        (("density", 1e3, -1.0, 1e4), "lower bound: density .*negative"),
    ],
)
def test_bounds_outside_the_range_of_the_material(parameter, message):
    field, start, lower, upper = parameter
    wide = Parameter(field, field, start, lower, upper, scale="linear")
    with pytest.raises(ValueError, match=message):
        check(model(), wide)


ENDS = ControlPoints({"root": (0.0, 0.25, 0.25), "tip": (1.0, 0.25, 0.25)})


def spread(field="E", points=ENDS, **changes):
    options = {"start": 2e5, "lower": 1e5, "upper": 1e6}
    return ControlPointParameters(field, points, **(options | changes))


def with_fibre():
    law = ReducedTransverseIsotropic(2e5, 1e5, 0.3, Fibre(0.0))
    return build_model(MESH, Corotational(law), density=1000.0)


def test_fields_with_control_points_are_fine():
    tip = ControlPoints([(0.6, 0.1, 0.1), (1.0, 0.5, 0.5)])
    bounds = {"start": 500.0, "lower": 1.0, "upper": 1e3}
    density = spread("density", tip, region="far", **bounds)
    stiff_tip = np.where(np.arange(12) < 6, 3e5, 3e6)
    check(model(stiff_tip), spread(), density)
    root = ControlPoints([(0.0, 0.1, 0.1), (0.4, 0.5, 0.5)])
    check(model(), spread(points=root, region="near"), modulus("b", "far"))


def test_control_points_and_a_parameter_must_not_set_the_same_tets():
    with pytest.raises(ValueError, match=r"'E of root, tip' and 'b' .*regions"):
        check(model(), spread(), modulus("b", "far"))


def test_control_point_far_outside_is_named_with_its_distance():
    """Millimetres for metres, or another frame."""
    points = ControlPoints({"root": (0.0, 0.25, 0.25), "tip": (1000.0, 250.0, 250.0)})
    message = r"'tip' of E .* 1059 m .* 122 mm"
    with pytest.raises(ValueError, match=message):
        check(model(), spread(points=points))


def test_max_distance_and_the_region_decide_what_is_far():
    outside = {"root": (0.0, 0.25, 0.25), "tip": (2.0, 0.5, 0.5)}
    with pytest.raises(ValueError, match=r"'tip' of E .* 1 m from the body"):
        check(model(), spread(points=ControlPoints(outside)))
    check(model(), spread(points=ControlPoints(outside, max_distance=1.01)))
    near = {"root": (0.0, 0.25, 0.25), "tip": (1.0, 0.25, 0.25)}
    message = "'tip' of E .* 612 mm .*'near': .* 100 mm"
    points = ControlPoints(near, max_distance=0.1)
    with pytest.raises(ValueError, match=message):
        check(model(), spread(points=points, region="near"))


def test_distance_counts_along_the_axes_of_the_control_points():
    above = [(0.0, 50.0, 0.25), (1.0, -50.0, 0.25)]
    check(model(), spread(points=ControlPoints(above, axes="xz")))
    with pytest.raises(ValueError, match=r"'CP 1' of E .* 49\.5 m .*body"):
        check(model(), spread(points=ControlPoints(above)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"nearest": 1}, r"nearest is 1\. Raise `nearest`"),
        ({"power": 1e4}, r"power 10000\. Lower `power`"),
    ],
)
def test_control_point_that_acts_on_no_tet(options, message):
    """The third stands behind the second."""
    positions = [(0.0, 0.25, 0.25), (1.0, 0.25, 0.25), (1.1, 0.25, 0.25)]
    with pytest.raises(ValueError, match="'CP 3' of E .*no tet.*" + message):
        check(model(), spread(points=ControlPoints(positions, **options)))
    check(model(), spread(points=ControlPoints(positions)))
    # A known value there does no harm.
    points = ControlPoints(positions, **options)
    check(model(), spread(points=points, fixed={"CP 3": 2e5}))


@pytest.mark.parametrize("order", [1, 2])
def test_bounds_of_a_field_outside_the_range_of_the_material(order):
    mesh = beam(1.0, 0.5, 0.5, (2, 1, 1), order=order)
    body = build_model(mesh, Corotational(Isotropic(2e5, 0.3)), density=1000.0)
    options = {"start": 0.3, "lower": 0.1, "scale": "linear"}
    check(body, spread("nu", upper=0.49, **options))
    with pytest.raises(ValueError, match=r"upper bound: nu .*\(-1, 0\.5\)"):
        check(body, spread("nu", upper=[0.4, 0.7], **options))


def test_known_value_outside_the_range_of_the_material():
    bad = spread(fixed={"tip": -1e7})
    with pytest.raises(ValueError, match=r"lower bound: E .*positive"):
        check(model(), bad)


HALF = np.pi / 2
ANGLE = ControlPointParameters(
    "theta",
    ENDS,
    start=0.0,
    lower=-HALF,
    upper=HALF,
    scale="linear",
    interpolation="director",
)


@pytest.mark.parametrize("way", ["order", "axes"])
@pytest.mark.parametrize(
    ("soft", "stiff", "message"),
    [
        ({}, {}, None),
        ({"start": 1.5e5}, {}, None),
        ({"start": [2e5, 3e5]}, {}, "E_l of tip above E_t of tip, but {way} "),
        ({"lower": 5e5, "start": 6e5}, {"upper": 4e5}, "E_l of root <= E_t of root: "),
    ],
)
def test_start_and_bounds_must_allow_the_order(way, soft, stiff, message):
    given = {"order": [("E_l", "E_t")]}
    if way == "axes":
        given = {"axes": [("E_l", "E_t", "theta")]}
    entries = (spread("E_l", **soft), spread("E_t", **stiff), ANGLE)
    space = ParameterSpace(entries, **given)
    if message is None:
        check_parameters(with_fibre(), space)
    else:
        with pytest.raises(ValueError, match=message.format(way=way)):
            check_parameters(with_fibre(), space)
