"""Steps of an axis with two moduli are taken as tensors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softcal_jax.fields import ControlPointParameters, ControlPoints, ParameterSpace

ENDS = ControlPoints({"root": (0.0, 0.0, 0.0), "tip": (1.0, 0.0, 0.0)})
SCALE = 0.5  # S of the angle [rad]
LOWER, UPPER = 100.0, 2000.0


def modulus(field, **changes):
    options = {"start": 500.0, "lower": LOWER, "upper": UPPER}
    return ControlPointParameters(field, ENDS, **(options | changes))


def angle(**changes):
    return ControlPointParameters(
        "theta",
        ENDS,
        start=0.0,
        lower=-np.pi / 2,
        upper=np.pi / 2,
        scale="linear",
        S=SCALE,
        interpolation="director",
        **changes,
    )


def space_of(**changes):
    """Columns: E_t of root and tip, E_l of root and tip, theta of root and tip."""
    return ParameterSpace(
        (modulus("E_t"), modulus("E_l", **changes), angle()),
        axes=[("E_l", "E_t", "theta")],
    )


SPACE = space_of()


def scaled(E_t, E_l, degrees, space=SPACE):
    theta = np.deg2rad(np.broadcast_to(degrees, 2))
    p = np.concatenate([np.broadcast_to(E_t, 2), np.broadcast_to(E_l, 2), theta])
    return space.to_scaled(jnp.asarray(p))


def random_parameters(seed, ratio=0.9):
    random = np.random.default_rng(seed)
    E_t = random.uniform(300.0, UPPER, 2)
    E_l = random.uniform(LOWER, ratio * E_t)
    return scaled(E_t, E_l, random.uniform(-89.0, 89.0, 2))


def matrix(m, c, s):
    """The symmetric tensor of trace 2 m, its deviator along the axis."""
    return np.array([[m + c, s], [s, m - c]])


def test_columns_of_the_axes():
    chart = SPACE.chart
    assert chart is not None
    np.testing.assert_array_equal(chart.small, [2, 3])
    np.testing.assert_array_equal(chart.large, [0, 1])
    np.testing.assert_array_equal(chart.angle, [4, 5])
    np.testing.assert_allclose(chart.S, [SCALE, SCALE])
    assert ParameterSpace((modulus("E_t"),)).chart is None


def test_tensor_has_the_log_moduli_on_its_axis():
    """Its eigenvalues are ln E_t and ln E_l; the soft axis is turned by theta."""
    z = scaled([900.0, 400.0], [300.0, 200.0], [20.0, -35.0])
    tensor = np.asarray(SPACE.chart.to_tensor(z))
    for i, (large, small, degrees) in enumerate(
        [(900.0, 300.0, 20.0), (400.0, 200.0, -35.0)]
    ):
        # Columns hold m where E_l was, c where E_t was, s where theta was.
        values, vectors = np.linalg.eigh(matrix(tensor[2 + i], *tensor[[i, 4 + i]]))
        np.testing.assert_allclose(np.exp(values), [small, large], rtol=1e-12)
        axis = np.array([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))])
        np.testing.assert_allclose(abs(axis @ vectors[:, 1]), 1.0, rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_round_trip(seed):
    z = random_parameters(seed)
    chart = SPACE.chart
    np.testing.assert_allclose(chart.from_tensor(chart.to_tensor(z)), z, rtol=1e-12)
    tensor = z + 0.1
    again = chart.to_tensor(chart.from_tensor(tensor))
    np.testing.assert_allclose(again, tensor, rtol=1e-12)


def test_half_a_turn_is_the_same_tensor():
    z = scaled(900.0, 300.0, [20.0, -35.0])
    turned = scaled(900.0, 300.0, [200.0, 145.0])
    np.testing.assert_allclose(
        SPACE.chart.to_tensor(turned), SPACE.chart.to_tensor(z), rtol=1e-12
    )


jacobian_from_tensor = jax.jit(jax.jacfwd(lambda t: SPACE.chart.from_tensor(t)))
jacobian_to_tensor = jax.jit(jax.jacfwd(lambda z: SPACE.chart.to_tensor(z)))


@pytest.mark.parametrize("gap", [1.0, 1e-2, 2e-6])
def test_jacobian_is_regular(gap):
    """|det| = 2 . 1/d . 1/(2 S) for each axis, in closed form, down to isotropy."""
    z = scaled(900.0, 900.0 * np.exp(-gap), [20.0, -80.0])
    chart = SPACE.chart
    J = jacobian_from_tensor(chart.to_tensor(z))
    d = 0.5 * gap
    np.testing.assert_allclose(
        abs(np.linalg.det(J)), (1.0 / (d * SCALE)) ** 2, rtol=1e-6
    )
    back = np.asarray(jacobian_to_tensor(z))
    np.testing.assert_allclose(J @ back, np.eye(6), atol=1e-7)


def test_crossing_the_origin_turns_the_axis_by_90_degrees():
    """The way out of a wrong axis leads through isotropy, and on."""
    z = scaled(900.0, 300.0, [20.0, -35.0])
    chart, step = SPACE.chart, np.zeros(6)
    tensor = chart.to_tensor(z)
    step[[0, 1, 4, 5]] = -2.0 * np.asarray(tensor)[[0, 1, 4, 5]]
    crossed = SPACE.from_scaled(chart.from_tensor(tensor + step))
    np.testing.assert_allclose(crossed[:4], [900, 900, 300, 300], rtol=1e-12)
    np.testing.assert_allclose(np.rad2deg(crossed[4:]), [-70.0, 55.0], rtol=1e-12)


def test_admissible_moduli_keep_bounds_order_and_a_gap():
    random = np.random.default_rng(0)
    low, high = np.asarray(SPACE.lower()), np.asarray(SPACE.upper())
    admissible = jax.jit(jax.vmap(SPACE.admissible))
    z = jnp.asarray(random.uniform(low - 2.0, high + 2.0, (100, 6)))
    kept = np.asarray(admissible(z))
    assert np.all(kept >= low)
    assert np.all(kept <= high)
    assert np.all(kept[:, :2] - kept[:, 2:4] >= 1.99e-7)
    # What was admissible stays where it was.
    np.testing.assert_allclose(admissible(jnp.asarray(kept)), kept, 1e-14)


@pytest.mark.parametrize("value", [LOWER, 500.0, UPPER])
def test_isotropic_start_is_moved_apart_by_a_trifle(value):
    p = SPACE.from_scaled(SPACE.admissible(scaled(value, value, 30.0)))
    np.testing.assert_allclose(p[:4], value, rtol=5e-7)
    np.testing.assert_allclose(np.rad2deg(p[4:]), 30.0, rtol=1e-12)
    chart = SPACE.chart
    J = jacobian_from_tensor(chart.to_tensor(SPACE.to_scaled(p)))
    assert np.all(np.isfinite(J))


def test_known_control_points_have_no_axis():
    """Only where all three are unknown; the rest of the space moves as it did."""
    space = space_of(fixed={"root": 300.0})
    chart = space.chart
    np.testing.assert_array_equal(chart.small, [2])
    np.testing.assert_array_equal(chart.large, [1])
    np.testing.assert_array_equal(chart.angle, [4])
    z = space.start() + jnp.array([0.1, 0.2, -0.3, 0.5, 0.1])
    moved = chart.to_tensor(z)
    np.testing.assert_array_equal(moved[jnp.array([0, 3])], z[jnp.array([0, 3])])


def test_control_points_tied_in_all_three_share_their_axis():
    """As in a symmetric body: the second is the first one's mirror image."""
    same = lambda field: {"tip": f"{field} of root"}
    space = ParameterSpace(
        (
            modulus("E_t", tied=same("E_t")),
            modulus("E_l", tied=same("E_l")),
            angle(tied=same("theta")),
        ),
        axes=[("E_l", "E_t", "theta")],
    )
    np.testing.assert_array_equal(space.chart.small, [1])
    np.testing.assert_array_equal(space.chart.large, [0])
