"""The space of parameters: room, wrapping, order constraints, and their errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    Parameter,
    ParameterSpace,
    as_space,
)

ENDS = ControlPoints({"root": (0.0, 0.0, 0.0), "tip": (1.0, 0.0, 0.0)})
OTHERS = ControlPoints({"left": (0.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0)})
QUARTER = np.pi / 2


def modulus(field, points=ENDS, **changes):
    options = {"start": 500.0, "lower": 100.0, "upper": 1000.0}
    return ControlPointParameters(field, points, **(options | changes))


def angle(points=ENDS, **changes):
    options = {"start": 0.0, "lower": -QUARTER, "upper": QUARTER, "scale": "linear"}
    options |= {"interpolation": "director", "S": 1.0}
    return ControlPointParameters("theta", points, **(options | changes))


def one(name, **changes):
    options = {"start": 500.0, "lower": 100.0, "upper": 1000.0}
    return Parameter(name, name, **(options | changes))


def scaled(space, **values):
    """Coordinates z of values in SI units, in the order of the space."""
    return space.to_scaled(jnp.asarray(list(values.values()), float))


def test_names_follow_the_entries_and_their_control_points():
    space = ParameterSpace((modulus("E_t"), one("nu"), angle(fixed={"tip": 0.1})))
    assert space.names == ["E_t of root", "E_t of tip", "nu", "theta of root"]


def test_a_single_entry_is_a_space():
    for entry in (modulus("E_t"), one("E")):
        assert as_space(entry).entries == (entry,)
        assert as_space([entry]).names == as_space(entry).names
    space = ParameterSpace((one("E"),))
    assert as_space(space) is space


def test_room_to_the_bounds_is_endless_for_a_free_axis():
    bounded = angle(OTHERS, lower=-0.5, upper=1.0, S=0.5)
    space = ParameterSpace((modulus("E"), angle(), bounded))
    z = space.to_scaled(jnp.array([100.0, 500.0, 1.0, -1.5, 0.25, 0.25]))
    down, up = space.room(z)
    log = np.log
    endless = np.inf
    np.testing.assert_allclose(
        down, [0.0, -log(5), -endless, -endless, -1.5, -1.5], atol=1e-15
    )
    np.testing.assert_allclose(up, [log(10), log(2), endless, endless, 1.5, 1.5])


def test_wrapping_brings_a_free_axis_back_and_leaves_the_rest():
    turn = angle(S=0.1, lower=0.0, upper=np.pi)
    space = ParameterSpace((modulus("E"), turn, angle(OTHERS, upper=1.0)))
    degrees = [190.0, -10.0, 170.0, -100.0]
    z = jnp.concatenate(
        [jnp.log(jnp.array([5.0, 7e3])), jnp.deg2rad(jnp.array(degrees[:2])) / 0.1]
    )
    z = jnp.concatenate([z, jnp.deg2rad(jnp.array(degrees[2:]))])
    p = space.from_scaled(space.wrap(z))
    np.testing.assert_allclose(p[:2], [5.0, 7e3], rtol=1e-13)
    np.testing.assert_allclose(np.rad2deg(p[2:4]), [10.0, 170.0], rtol=1e-12)
    np.testing.assert_allclose(np.rad2deg(p[4:]), degrees[2:], rtol=1e-13)


def test_admissible_is_within_the_bounds():
    space = ParameterSpace((modulus("E"), angle()))
    z = scaled(space, a=50.0, b=2000.0, c=2.0, d=-0.3)
    p = space.from_scaled(space.admissible(z))
    np.testing.assert_allclose(p, [100.0, 1000.0, 2.0 - np.pi, -0.3], rtol=1e-13)


def test_step_limits_stand_where_they_were_given():
    space = ParameterSpace((modulus("E", max_step=0.01), one("nu"), angle(OTHERS)))
    expected = [0.01, 0.01, np.inf, np.inf, np.inf]
    np.testing.assert_array_equal(space.max_step(), expected)


LOG = {}
SAME_S = {"scale": "linear", "S": 50.0}


@pytest.mark.parametrize(
    ("small", "large"),
    [
        (LOG, LOG),
        (SAME_S, SAME_S),
        (SAME_S, {"scale": "linear", "S": 2000.0}),
        ({"scale": "linear", "S": 2000.0}, {"scale": "linear"}),
    ],
)
def test_order_rows_say_what_the_values_say(small, large):
    """A z <= b at a control point where, and only where, E_l <= E_t there."""
    space = ParameterSpace(
        (modulus("E_t", **large), modulus("E_l", **small)), order=[("E_l", "E_t")]
    )
    assert space.order_names() == [
        ("E_l of root", "E_t of root"),
        ("E_l of tip", "E_t of tip"),
    ]
    A, b = space.order_rows()
    np.testing.assert_allclose(np.abs(A).max(axis=1), 1.0)
    random = np.random.default_rng(0)
    for p in random.uniform(100.0, 1000.0, (50, 4)):
        kept = np.asarray(A @ space.to_scaled(jnp.asarray(p)) <= b)
        np.testing.assert_array_equal(kept, [p[2] <= p[0], p[3] <= p[1]])
    equal = scaled(space, a=300.0, b=700.0, c=300.0, d=700.0)
    np.testing.assert_allclose(A @ equal, b, atol=1e-13)


@pytest.mark.parametrize("scale", ["log", "linear"])
@pytest.mark.parametrize("known", ["E_l", "E_t"])
def test_order_with_a_known_value(scale, known):
    fixed = {known: {"root": 400.0}}
    entries = tuple(
        modulus(field, scale=scale, fixed=fixed.get(field)) for field in ("E_l", "E_t")
    )
    space = ParameterSpace(entries, order=[("E_l", "E_t")])
    A, b = space.order_rows()
    sign = 1.0 if known == "E_t" else -1.0  # E_l below it, or E_t above
    column = space.names.index({"E_t": "E_l", "E_l": "E_t"}[known] + " of root")
    for value in (399.0, 401.0):
        z = space.start().at[column].set(space.to_scaled(jnp.full(3, value))[column])
        kept = bool(A[0] @ z <= b[0])
        assert kept == (sign * value <= sign * 400.0)
    assert A.shape == (2, 3)


def test_order_of_two_known_values_adds_no_row():
    entries = lambda l: (
        modulus("E_t", fixed={"root": 600.0}),
        modulus("E_l", fixed={"root": l}),
    )
    space = ParameterSpace(entries(400.0), order=[("E_l", "E_t")])
    assert space.order_names() == [("E_l of tip", "E_t of tip")]
    with pytest.raises(
        ValueError, match=r"E_l of root <= E_t of root, .*both are fixed"
    ):
        ParameterSpace(entries(700.0), order=[("E_l", "E_t")])


def test_order_follows_ties_and_single_parameters():
    entries = (
        modulus("E_t"),
        modulus("E_l", tied={"tip": "floor"}),
        one("floor"),
    )
    order = [("E_l", "E_t"), ("floor", "E_t of root")]
    space = ParameterSpace(entries, order=order)
    assert space.order_names() == [
        ("E_l of root", "E_t of root"),
        ("floor", "E_t of tip"),
        ("floor", "E_t of root"),
    ]
    # Columns: E_t of root, E_t of tip, E_l of root, floor.
    expected = [[-1, 0, 1, 0], [0, -1, 0, 1], [-1, 0, 0, 1]]
    np.testing.assert_array_equal(space.order_rows()[0], expected)


def test_order_rows_can_be_traced():
    """Bounds, S and known values are arguments of a compiled program."""
    entries = (modulus("E_t"), modulus("E_l", fixed={"root": 400.0}))
    space = ParameterSpace(entries, order=[("E_l", "E_t")])
    A, b = jax.jit(lambda s: s.order_rows())(space)
    np.testing.assert_allclose(A, space.order_rows()[0])
    np.testing.assert_allclose(b, [-np.log(400.0), 0.0])


@pytest.mark.parametrize(
    ("entries", "order", "message"),
    [
        ([modulus("E")], ["E_l"], r"order .*E_t.* \('E_l',\)\."),
        ([modulus("E")], [("a", "b", "c")], r"order .*E_t.* \('a', 'b', 'c'\)"),
        ([modulus("E_t")], [("E_l", "E_t")], "order: .*'E_l'.*'E_t of root', "),
        (
            [modulus("E_t"), modulus("E_l", OTHERS)],
            [("E_l", "E_t")],
            r"'E_l', 'E_t'.*\(left, right and root, tip\)",
        ),
        (
            [modulus("E_t"), modulus("E_l", scale="linear")],
            [("E_l", "E_t")],
            "same scale.* 'linear' and 'log'",
        ),
        (
            [
                modulus("E_t", region="a"),
                modulus("E_t", region="b", fixed={"root": 1.0, "tip": 2.0}),
                modulus("E_l"),
            ],
            [("E_l", "E_t")],
            "E_t .*'root'.*different names",
        ),
        ([modulus("E", tied={"tip": "nu"})], [], "E of tip .*'nu'.*'E of root'"),
        ([modulus("E"), modulus("E")], [], "'E of root' .*more than once"),
        ([modulus("E", fixed={"root": 1, "tip": 2})], [], "at least one parameter"),
    ],
)
def test_bad_space(unchecked, entries, order, message):
    with pytest.raises(ValueError, match=message):
        ParameterSpace(entries, order=order)


AXIS = [("E_l", "E_t", "theta")]
FREELY = "'theta of root' .*director.* 180 deg"


@pytest.mark.parametrize(
    ("changes", "axes", "message"),
    [
        ({}, ["E_l"], r"axes .*theta.* \('E_l',\)\."),
        ({}, [("E_l", "E_t")], r"axes .*theta.* \('E_l', 'E_t'\)\."),
        ({}, [("E_l", "E_t", "phi")], "axes: .*'phi'"),
        ({"E_l": modulus("E_l", scale="linear")}, AXIS, "'E_l of root' .*log.*linear"),
        ({"theta": angle(upper=1.0)}, AXIS, FREELY),
        ({"theta": angle(interpolation="linear")}, AXIS, FREELY),
        ({"E_t": modulus("E_t", max_step=0.1)}, AXIS, "'E_t of root' .*max_step"),
        ({"theta": angle(max_step=0.1)}, AXIS, "'theta of root' .*max_step"),
        ({"theta": angle(OTHERS)}, AXIS, "no control point .*give .*same"),
        (
            {"theta": angle(fixed={"root": 0.0, "tip": 1.0})},
            AXIS,
            "no control point .*unknown",
        ),
        ({}, AXIS * 2, "'E_l of root' belongs to more than one"),
        (
            {"E_l": modulus("E_l", tied={"tip": "E_l of root"})},
            AXIS,
            "'E_l of root' belongs to more than one",
        ),
    ],
)
def test_bad_axes(unchecked, changes, axes, message):
    parts = {"E_t": modulus("E_t"), "E_l": modulus("E_l"), "theta": angle()} | changes
    with pytest.raises(ValueError, match=message):
        ParameterSpace(list(parts.values()), axes=axes)


@pytest.mark.parametrize("convert", ["to_scaled", "from_scaled"])
def test_each_parameter_needs_one_value(convert):
    space = as_space([one("E"), one("nu")])
    with pytest.raises(ValueError, match=r"3 values .* 2 .*\(E, nu\)"):
        getattr(space, convert)(jnp.ones(3))
