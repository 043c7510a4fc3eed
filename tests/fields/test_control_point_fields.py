"""Fields with a value per control point: how they are mixed, and where."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softcal_jax.equilibrium import build_model
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    Parameter,
    ParameterSpace,
)
from softcal_jax.materials import Corotational, Fibre, TransverseIsotropic
from softcal_jax.mesh import beam

SIZE = (1.0, 0.5, 0.5)
MESH = beam(*SIZE, (2, 1, 1)).with_tet_group("one", [4])
CENTROIDS = MESH.points[MESH.tets].mean(axis=1)
ENDS = ControlPoints({"root": (0.0, 0.25, 0.2), "tip": (1.0, 0.2, 0.25)})
# The centroid of the tet "one" lies half way between these two.
MIDDLE = ControlPoints(CENTROIDS[4] + np.array([[0.3, 0.0, 0.1], [-0.3, 0.0, -0.1]]))


def law(E_t=1000.0):
    fibre = Fibre(0.0, plane="xy")
    return Corotational(TransverseIsotropic(E_t, 500.0, 0.3, 0.2, 200.0, fibre))


@pytest.fixture(scope="module")
def model():
    return build_model(MESH, law(), density=1000.0)


def modulus(points=ENDS, field="E_t", **changes):
    options = {"start": 1000.0, "lower": 100.0, "upper": 1e4, "unit": "Pa"}
    return ControlPointParameters(field, points, **(options | changes))


def angle(points=ENDS, **changes):
    half = np.pi / 2
    options = {"start": 0.0, "lower": -half, "upper": half, "scale": "linear"}
    options |= {"unit": "rad", "interpolation": "director"}
    return ControlPointParameters("theta", points, **(options | changes))


def values_of(entry, values):
    names = [q.name for q in entry.parameters]
    return dict(zip(names, jnp.asarray(values, float), strict=True))


def by_hand(points, values):
    """Inverse squares of the distances to the two ends, in ordinary NumPy."""
    squares = [np.sum((points - np.asarray(x)) ** 2, axis=-1) for x in ENDS.positions]
    shares = [1.0 / squares[0], 1.0 / squares[1]]
    return (shares[0] * values[0] + shares[1] * values[1]) / (shares[0] + shares[1])


def test_linear_field_by_hand():
    field = modulus().evaluate(MESH, values_of(modulus(), [300.0, 900.0]))
    np.testing.assert_allclose(field, by_hand(CENTROIDS, [300.0, 900.0]), rtol=1e-13)
    assert np.ptp(field) > 300.0


def test_log_field_is_the_linear_one_of_the_logarithms():
    entry = modulus(interpolation="log")
    field = entry.evaluate(MESH, values_of(entry, [10.0, 1e5]))
    expected = np.exp(by_hand(CENTROIDS, np.log([10.0, 1e5])))
    np.testing.assert_allclose(field, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("interpolation", "values", "middle"),
    [
        ("linear", [100.0, 400.0], 250.0),
        ("log", [100.0, 400.0], 200.0),
        ("director", np.deg2rad([10.0, 40.0]), np.deg2rad(25.0)),
        ("linear", np.deg2rad([85.0, -85.0]), 0.0),
    ],
)
def test_half_way_between_two_control_points(interpolation, values, middle):
    bounds = {"start": 1.0, "lower": 0.5, "upper": 1.5}
    entry = modulus(MIDDLE, region="one", interpolation=interpolation, **bounds)
    field = entry.evaluate(MESH, values_of(entry, values))
    np.testing.assert_allclose(field, [middle], rtol=1e-12, atol=1e-12)


def test_directors_at_85_and_minus_85_degrees_meet_at_90():
    entry = angle(MIDDLE, region="one")
    field = entry.evaluate(MESH, values_of(entry, np.deg2rad([85.0, -85.0])))
    np.testing.assert_allclose(np.abs(np.rad2deg(field)), [90.0], rtol=1e-12)


@pytest.mark.parametrize("turned", [0, 1])
def test_half_a_turn_is_the_same_axis(turned):
    values = np.deg2rad([70.0, -35.0])
    plain = angle().evaluate(MESH, values_of(angle(), values))
    values[turned] += np.pi
    again = angle().evaluate(MESH, values_of(angle(), values))
    axis = lambda theta: np.stack([np.cos(2.0 * theta), np.sin(2.0 * theta)])
    np.testing.assert_allclose(axis(plain), axis(again), rtol=0, atol=1e-14)


def test_director_derivative_in_closed_form():
    """w_j cos 2 (theta_j - theta) / |sum_k w_k exp(2 i theta_k)|.

    It exceeds w_j where the axes differ: the director turns faster than a number.
    """
    values = np.deg2rad([70.0, -65.0])
    entry = angle()
    names = [q.name for q in entry.parameters]
    field = lambda v: entry.evaluate(MESH, dict(zip(names, v, strict=True)))
    slope = jax.jit(jax.jacfwd(field))(jnp.asarray(values))
    w = np.stack([by_hand(CENTROIDS, [1.0, 0.0]), by_hand(CENTROIDS, [0.0, 1.0])])
    mixed = w.T @ np.exp(2j * values)
    theta = 0.5 * np.angle(mixed)
    expected = (
        w.T * np.cos(2.0 * (values[None] - theta[:, None])) / np.abs(mixed)[:, None]
    )
    np.testing.assert_allclose(slope, expected, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
def test_directors_at_right_angles_have_a_finite_derivative(derivative):
    """Half way between 0 and 90 degrees no mean direction exists."""
    entry = angle(MIDDLE, region="one")
    names = [q.name for q in entry.parameters]
    field = lambda v: entry.evaluate(MESH, dict(zip(names, v, strict=True)))
    values = jnp.asarray([0.0, np.pi / 2])
    assert np.isfinite(field(values)).all()
    slope = jax.jit(derivative(field))(values)
    np.testing.assert_array_equal(slope, [[0.0, 0.0]])


def test_start_and_bounds_at_each_control_point():
    entry = modulus(start=[200.0, 300.0], lower=[150.0, 250.0], upper=[1e3, 2e3])
    one, other = entry.parameters
    assert [one.name, other.name] == ["E_t of root", "E_t of tip"]
    assert [float(v) for v in (one.start, one.lower, one.upper)] == [200, 150, 1e3]
    assert [float(v) for v in (other.start, other.lower, other.upper)] == [
        300,
        250,
        2e3,
    ]
    assert one.unit == other.unit == "Pa"


def test_options_reach_every_unknown():
    entry = modulus(scale="linear", S=50.0, max_step=0.01, region="one")
    for q in entry.parameters:
        assert (q.scale, float(q.unit_step), q.region) == ("linear", 50.0, "one")
        assert float(q.max_step) == 0.01


def test_fixed_control_point_is_no_unknown():
    entry = modulus(fixed={"root": 300.0})
    assert [q.name for q in entry.parameters] == ["E_t of tip"]
    field = entry.evaluate(MESH, {"E_t of tip": jnp.asarray(900.0)})
    np.testing.assert_allclose(field, by_hand(CENTROIDS, [300.0, 900.0]), rtol=1e-13)


def test_tied_across_two_regions_and_two_fields(model):
    """One unknown sets E_t at both ends of one region, and E_l at one of another."""
    mesh = MESH.with_tet_group("rest", np.delete(np.arange(12), 4))
    body = build_model(mesh, law(), density=1000.0)
    first = modulus(region="one", tied={"tip": "E_t of root"})
    far = ControlPoints(ENDS.positions, names=["r", "t"])
    second = modulus(far, field="E_l", region="rest", tied={"t": "E_t of root"})
    space = ParameterSpace((first, second))
    assert space.names == ["E_t of root", "E_l of r"]
    elastic = space.model_at(body, jnp.log(jnp.array([700.0, 200.0]))).law.elasticity
    rest = np.delete(np.arange(12), 4)
    np.testing.assert_allclose(elastic.E_t[4], 700.0, rtol=1e-13)
    np.testing.assert_array_equal(elastic.E_t[rest], 1000.0)
    np.testing.assert_allclose(
        elastic.E_l[rest], by_hand(CENTROIDS[rest], [200.0, 700.0]), rtol=1e-13
    )
    np.testing.assert_array_equal(elastic.E_l[4], 500.0)


def test_tied_to_a_single_parameter():
    """The control point takes over its value, in the units of the other."""
    whole = Parameter("E_l", "E_l", 500.0, 100.0, 1e4)
    space = ParameterSpace((whole, modulus(tied={"tip": "E_l"})))
    assert space.names == ["E_l", "E_t of root"]


def test_density_is_spread_too(model):
    entry = modulus(field="density")
    body = ParameterSpace((entry,)).model_at(model, jnp.log(jnp.array([300.0, 900.0])))
    np.testing.assert_allclose(
        body.density, by_hand(CENTROIDS, [300.0, 900.0]), rtol=1e-13
    )


def test_the_mean_of_a_field_converges_at_second_order():
    """Its integral over the body, from one value per tet."""
    outside = ControlPoints([(-0.5, 0.2, 0.3), (1.4, 0.6, -0.2)])
    nodes, gauss = np.polynomial.legendre.leggauss(20)
    axes = [0.5 * size * (nodes + 1.0) for size in SIZE]
    X = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    squares = [np.sum((X - np.asarray(x)) ** 2, axis=-1) for x in outside.positions]
    field = 300.0 + 600.0 * squares[0] / (squares[0] + squares[1])
    exact = np.einsum("i,j,k,ijk", gauss, gauss, gauss, field) / 8.0
    entry = modulus(outside)
    values = values_of(entry, [300.0, 900.0])
    # All tets of these meshes have the same volume.
    coarse, fine = (
        float(jnp.mean(entry.evaluate(beam(*SIZE, (2 * n, n, n), order=2), values)))
        - exact
        for n in (2, 4)
    )
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.05)


def test_full_turn_of_the_bounds_makes_an_angle_periodic():
    assert all(q.periodic for q in angle().parameters)
    assert not any(q.periodic for q in angle(upper=1.0).parameters)
    assert not any(q.periodic for q in angle(interpolation="linear").parameters)
    mixed = angle(lower=[-np.pi / 2, 0.0])
    assert [q.periodic for q in mixed.parameters] == [True, False]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"lower": [1.0, 2.0, 3.0]}, r"lower of E_t .*\(2\).* \(3,\)"),
        ({"start": [[1.0]]}, r"start of E_t .*\(2\).* \(1, 1\)"),
        ({"fixed": {"top": 1.0}}, "fixed of E_t: 'top'.*'root', 'tip'"),
        ({"tied": {"top": "x"}}, "tied of E_t: 'top'.*'root', 'tip'"),
        ({"fixed": {"tip": 1.0}, "tied": {"tip": "x"}}, "'tip' of E_t .* tied"),
        ({"interpolation": "cubic"}, "'cubic'.*'director', 'linear', 'log'"),
        (
            {"interpolation": "director", "lower": 0.0, "upper": 3.5},
            "E_t span 201 degrees.* 180",
        ),
    ],
)
def test_bad_field(unchecked, changes, message):
    with pytest.raises(ValueError, match=message):
        modulus(**changes)


def test_entry_is_a_pytree_of_its_numbers():
    """Another start reuses a compiled program: nothing but names is static."""
    entry = modulus(fixed={"tip": 2.0})
    moved = eqx.tree_at(lambda e: e.start, entry, entry.start * 2.0)
    assert jax.tree.structure(moved) == jax.tree.structure(entry)
    assert len(jax.tree.leaves(entry)) == 5  # positions, start, bounds, fixed
