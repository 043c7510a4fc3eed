import numpy as np
import pytest

from softcal_jax.configurations import (
    STANDARD_GRAVITY,
    Configuration,
    PointForce,
    Support,
    SurfaceForce,
    configuration_arrays,
)
from softcal_jax.mesh import beam

MESH = beam(0.1, 0.02, 0.02, (4, 2, 2))
CLAMP = Support("x_min")
X_MIN, X_MAX = MESH.nodes("x_min"), MESH.nodes("x_max")


def one(*supports, **rest):
    """The single lane of a configuration, without its leading axis."""
    arrays = configuration_arrays(MESH, [Configuration("one", supports, **rest)])
    return np.asarray(arrays.fixed[0]), np.asarray(arrays.imposed[0])


def test_clamp_and_partial_support():
    fixed, imposed = one(CLAMP, Support("x_max", axes="z"))
    assert fixed[X_MIN].all()
    np.testing.assert_array_equal(fixed[X_MAX], [[False, False, True]] * len(X_MAX))
    assert fixed.sum() == 3 * len(X_MIN) + len(X_MAX)
    np.testing.assert_array_equal(imposed, 0.0)


def test_imposed_displacement_on_the_held_axes_only():
    fixed, imposed = one(CLAMP, Support("x_max", "xz", (1e-3, 5e-3, -2e-3)))
    np.testing.assert_array_equal(imposed[X_MAX], [[1e-3, 0.0, -2e-3]] * len(X_MAX))
    assert not fixed[X_MAX, 1].any()


def test_nodes_by_index_and_axes_in_any_order():
    by_name = one(CLAMP, Support("x_max", "xz"))
    by_index = one(Support(X_MIN), Support(X_MAX, "zx"))
    np.testing.assert_array_equal(by_index[0], by_name[0])


def test_lanes_keep_their_own_supports_loads_and_gravity():
    lanes = configuration_arrays(
        MESH,
        [
            Configuration("left", (CLAMP,), loads=(SurfaceForce("x_max", (1, 0, 0)),)),
            Configuration(
                "right",
                (Support("x_max"),),
                gravity=(0, 9.81, 0),
                loads=(
                    PointForce((0.0, 0.01, 0.01), (0, 2.0, 0)),
                    SurfaceForce("x_min", (0, 0, 3.0)),
                ),
            ),
        ],
    )
    assert bool(lanes.fixed[0, X_MIN].all() & lanes.fixed[1, X_MAX].all())
    assert not bool(lanes.fixed[0, X_MAX].any() | lanes.fixed[1, X_MIN].any())
    np.testing.assert_allclose(
        lanes.loads.force.sum(axis=(1, 2)), [[1, 0, 0], [0, 2, 3]], rtol=0, atol=1e-12
    )
    np.testing.assert_array_equal(
        lanes.gravity, [[0, 0, -STANDARD_GRAVITY], [0, 9.81, 0]]
    )


def test_two_supports_may_agree_and_must_not_clash():
    one(CLAMP, Support("z_min", "x"))
    with pytest.raises(ValueError, match=r"node 0 .*twice along x"):
        one(CLAMP, Support("z_min", "x", (1e-3, 0, 0)))
    # Held along other axes is no clash.
    one(CLAMP, Support("x_max", "x"), Support("x_max", "y", (9.0, 1e-3, 0)))


@pytest.mark.parametrize(
    ("supports", "free"),
    [
        ((), 6),
        ((Support(np.array([0])),), 3),
        ((Support("x_min", "x"),), 3),
        ((Support("x_min", "yz"),), 3),
        ((Support(np.flatnonzero((MESH.points[:, 1:] == 0).all(axis=1))),), 1),
    ],
    ids=["nothing", "one node", "sliding in plane", "sliding out of plane", "hinge"],
)
def test_a_body_that_is_not_held(supports, free):
    with pytest.raises(ValueError, match=f"'one' .* {free} of the 6 .*Clamp"):
        configuration_arrays(MESH, [Configuration("one", supports)])


def test_bad_supports():
    with pytest.raises(ValueError, match=r"axes .*xyz.* got 'xa'"):
        Support("x_min", "xa")
    with pytest.raises(ValueError, match=r"displacement .*\[m\], got \(0\.0, nan"):
        Support("x_min", "x", (0.0, np.nan, 0.0))
    with pytest.raises(ValueError, match=r"'x_mim'\. .*'x_min'\?"):
        one(Support("x_mim"))


def test_bad_configurations():
    with pytest.raises(ValueError, match="least one configuration"):
        configuration_arrays(MESH, [])
    twice = [Configuration("one", (CLAMP,)), Configuration("one", (CLAMP,))]
    with pytest.raises(ValueError, match=r"configuration 'one' .*another name"):
        configuration_arrays(MESH, twice)
    with pytest.raises(ValueError, match=r"gravity .*'one' .*\[m/s2\]"):
        Configuration("one", (CLAMP,), gravity=(0.0, 0.0, np.inf))


ONE = [CLAMP, "x_min", ["x_min"], (CLAMP,), [CLAMP], X_MIN, [X_MIN]]


@pytest.mark.parametrize("supports", ONE)
def test_one_support_or_its_nodes(supports):
    configuration = Configuration("one", supports)
    fixed = configuration_arrays(MESH, [configuration]).fixed[0]
    assert fixed[X_MIN].all()
    np.testing.assert_array_equal(np.flatnonzero(fixed.any(axis=1)), X_MIN)


def test_one_load():
    load = SurfaceForce("x_max", (1.0, 0.0, 0.0))
    assert Configuration("one", CLAMP, loads=load).loads == (load,)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("where", "message"),
    [
        (MESH.points[:, 0] == 0.0, r"support .*np\.flatnonzero .* bool"),
        (np.array([0.0, 1.0]), "node indices, got float64"),
        (3, r"group or .*int64 .*shape \(\)"),
        (np.array([0, -1]), "node -1.* 0 to 44"),
        (np.array([45, 0]), "support: node 45"),
    ],
)
def test_bad_nodes(where, message):
    with pytest.raises(ValueError, match=message):
        one(CLAMP, Support(where))


@pytest.mark.usefixtures("unchecked")
def test_numbers_are_no_supports():
    with pytest.raises(ValueError, match=r"list of integer node indices, got int64"):
        one(*X_MIN.tolist())
