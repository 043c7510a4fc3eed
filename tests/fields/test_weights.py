"""Inverse-distance weights and the control points that they belong to."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import assert_second_order

from softcal_jax.fields import ControlPoints

ORIGIN = np.zeros((1, 3))
# At the distances 1, 2 and 4 from the origin.
ALONG = np.array([[1.0, 0.0, 0.0], [0.0, -2.0, 0.0], [0.0, 0.0, 4.0]])


def idw_weights(points, positions, **options):
    """Weights of control points at positions that may be traced."""
    somewhere = ControlPoints(np.arange(3.0 * len(positions)).reshape(-1, 3), **options)
    moved = eqx.tree_at(lambda c: c.positions, somewhere, jnp.asarray(positions))
    return moved.weights(points)


def scattered(seed=0, n_points=40, n_cp=6):
    random = np.random.default_rng(seed)
    return random.normal(size=(n_points, 3)), random.normal(size=(n_cp, 3))


@pytest.mark.parametrize(
    ("power", "shares"), [(1.0, [4, 2, 1]), (2.0, [16, 4, 1]), (4.0, [256, 16, 1])]
)
def test_weights_by_hand(power, shares):
    weights = idw_weights(ORIGIN, ALONG, power=power)
    np.testing.assert_allclose(weights, [np.array(shares) / sum(shares)], rtol=1e-14)


def test_power_two_is_the_default():
    np.testing.assert_allclose(
        idw_weights(ORIGIN, ALONG), [[16 / 21, 4 / 21, 1 / 21]], rtol=1e-14
    )


@pytest.mark.parametrize("power", [0.5, 2.0, 7.0])
@pytest.mark.parametrize("nearest", [None, 1, 3])
def test_rows_sum_to_one(power, nearest):
    weights = np.asarray(idw_weights(*scattered(), power=power, nearest=nearest))
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-14)
    assert weights.min() >= 0.0


def test_unit_of_length_does_not_matter():
    """No length is built in: a body in micrometres has the weights of one in metres."""
    points, control = scattered()
    small = idw_weights(1e-6 * points, 1e-6 * control, power=3.0)
    np.testing.assert_allclose(small, idw_weights(points, control, power=3.0), 1e-12)


def test_point_on_a_control_point_takes_it_alone():
    weights = idw_weights(ALONG, ALONG, power=2.0)
    np.testing.assert_allclose(weights, np.eye(3), rtol=0, atol=1e-300)


def test_nearest_leaves_the_others_out():
    weights = idw_weights(ORIGIN, ALONG, nearest=2)
    np.testing.assert_allclose(weights, [[0.8, 0.2, 0.0]], rtol=1e-14)
    every = idw_weights(*scattered(), nearest=6)
    np.testing.assert_array_equal(every, idw_weights(*scattered()))


def test_huge_power_is_the_nearest_neighbour():
    points, control = scattered()
    distances = np.linalg.norm(points[:, None] - control[None], axis=2)
    expected = np.eye(6)[distances.argmin(axis=1)]
    weights = idw_weights(1e-3 * points, 1e-3 * control, power=1e5)
    np.testing.assert_allclose(weights, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("power", [1.0, 2.0, 6.0])
def test_derivative_in_control_points(power):
    """Autodiff meets central differences at second order."""
    points, control = scattered()
    tangent = np.random.default_rng(1).normal(size=control.shape)
    weights = lambda c: idw_weights(points, c, power=power)
    control, tangent = jnp.asarray(control), jnp.asarray(tangent)
    _, jvp = jax.jvp(weights, (control,), (tangent,))
    assert_second_order(weights, control, tangent, jvp, (3e-3, 3e-4), rtol=0.03)


@pytest.mark.parametrize("power", [1.0, 2.0, 5.0])
@pytest.mark.parametrize("nearest", [None, 2])
def test_derivative_on_a_control_point_is_finite(power, nearest):
    """The weight of a point on a control point has its largest value there."""
    points = jnp.concatenate([jnp.asarray(ALONG[:1]), jnp.zeros((1, 3))])
    weights = lambda c: idw_weights(points, c, power=power, nearest=nearest)
    for derivative in (jax.jacfwd, jax.jacrev):
        slope = derivative(weights)(jnp.asarray(ALONG))
        assert np.all(np.isfinite(slope))
        np.testing.assert_allclose(slope[0], 0.0, atol=1e-100)
        assert np.max(np.abs(slope[1])) > 0.01  # elsewhere it is there


@pytest.mark.parametrize("power", [0.0, -2.0, np.nan, np.inf])
def test_bad_power(power):
    with pytest.raises(ValueError, match=rf"power .* got {power:g}: .* 2\."):
        ControlPoints(ALONG, power=power)


@pytest.mark.parametrize("nearest", [0, -1, 4])
def test_bad_nearest(nearest):
    with pytest.raises(ValueError, match=f"nearest .* 3, got {nearest}"):
        ControlPoints(ALONG, nearest=nearest)


def test_names_count_from_one_or_come_from_the_mapping():
    assert ControlPoints(ALONG).names == ("CP 1", "CP 2", "CP 3")
    assert ControlPoints(ALONG, names=["a", "b", "c"]).names == ("a", "b", "c")
    named = ControlPoints({"root": (0.0, 0.0, 0.0), "tip": ALONG[2]})
    assert named.names == ("root", "tip")
    np.testing.assert_array_equal(named.positions, [[0, 0, 0], [0, 0, 4]])


def test_options_reach_the_weights():
    points = ControlPoints(ALONG, power=1.0, nearest=2)
    np.testing.assert_allclose(
        points.weights(ORIGIN), [[2 / 3, 1 / 3, 0.0]], rtol=1e-14
    )


def test_two_sheets_share_a_field_of_x_and_z():
    """Points above each other have the same weights, whatever their height."""
    flat = ControlPoints([(0.0, 5.0, 0.0), (3.0, -5.0, 0.0)], axes="xz")
    points = np.array([[1.0, 0.0, 0.0], [1.0, 7.0, 0.0]])
    np.testing.assert_allclose(flat.weights(points), [[0.8, 0.2]] * 2, rtol=1e-14)
    full = ControlPoints(flat.positions)
    assert np.ptp(full.weights(points), axis=0).min() > 0.1


@pytest.mark.parametrize(
    ("positions", "changes", "message"),
    [
        (ALONG[:, :2], {}, r"'CP 1' .*three finite .* \[m\], got \[.* .*\]"),
        (np.zeros((0, 3)), {}, "at least one .*none"),
        ({}, {}, "at least one .*none"),
        ({"a": (0, 0, 0), "b": (1, 2)}, {}, r"'b' .*three finite .* \(1, 2\)"),
        (ALONG, {"names": ["a", "b"]}, r"3 control points .*names, got a, b\."),
        (ALONG, {"names": ["a", "b", "a"]}, r"different names, got a, b, a\."),
        (ALONG, {"axes": "xx"}, "axes .*once.* 'xx'"),
        (ALONG, {"axes": "xw"}, "axes .* 'xw'"),
        (ALONG, {"axes": ""}, "axes .* ''"),
        (ALONG, {"max_distance": -0.1}, r"max_distance .*\[m\], got -0\.1"),
        (ALONG, {"max_distance": np.nan}, "max_distance .* nan"),
        ([(np.inf, 0, 0), *ALONG], {}, "'CP 1' .*three finite .*inf"),
        (np.vstack([ALONG, [[0, np.nan, 0]]]), {}, "'CP 4' .*three finite .*nan"),
        (np.vstack([ALONG, ALONG[1]]), {}, "'CP 2' and 'CP 4' coincide"),
        (np.add(ALONG, 1e9), {"axes": "z"}, "'CP 1' and 'CP 2' coincide along z"),
        ([(0, 1, 0), (0, 2, 0)], {"axes": "xz"}, "coincide along xz.*Remove one"),
    ],
)
def test_bad_control_points(unchecked, positions, changes, message):
    if not isinstance(positions, dict):
        positions = np.asarray(positions, float)
    with pytest.raises(ValueError, match=message):
        ControlPoints(positions, **changes)


def test_close_control_points_are_not_one():
    near = np.add(ALONG[:1], [[0.0, 1e-6, 0.0]])
    assert ControlPoints(np.vstack([ALONG, near])).names[-1] == "CP 4"
