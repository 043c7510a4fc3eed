import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softcal_jax.configurations import (
    Configuration,
    Markers,
    Support,
    configuration_arrays,
)
from softcal_jax.mesh import beam

MESH = beam(0.1, 0.02, 0.02, (4, 2, 2), order=2)
CLAMP = (Support("x_min"),)
INSIDE, POST = [0.053, 0.011, 0.004], [0.1, 0.01, 0.028]


def markers(**changed):
    return Markers(**{"names": ["a", "b"], "positions": [INSIDE, POST]} | changed)


@pytest.mark.parametrize("order", [1, 2])
def test_a_post_outside_the_mesh_follows_a_rigid_motion(order):
    """Affine extrapolation: exact for every affine motion, rotations among them."""
    mesh = beam(0.1, 0.02, 0.02, (4, 2, 2), order=order)
    configuration = Configuration("one", CLAMP, markers=markers())
    effectors = configuration_arrays(mesh, [configuration]).effectors
    nodes, weights = effectors.nodes[0], np.asarray(effectors.weights[0])
    Q, t = Rotation.random(rng=0).as_matrix(), np.array([0.3, -0.2, 0.1])
    np.testing.assert_allclose(
        np.sum(weights[..., None] * (mesh.points @ Q.T + t)[nodes], axis=1),
        np.array([INSIDE, POST]) @ Q.T + t,
        rtol=0,
        atol=1e-15,
    )


def test_precision_per_marker_and_axis():
    both = markers(std=np.array([1e-3, 2e-3]), axes="xz").stds()
    np.testing.assert_array_equal(both, [[1e-3, np.inf, 1e-3], [2e-3, np.inf, 2e-3]])
    std = np.array([[1.0, 2.0, 4.0], [0.5, 0.25, 0.125]])
    np.testing.assert_array_equal(markers(std=std).stds(), std)
    np.testing.assert_array_equal(markers(std=0.5).stds(), np.full((2, 3), 0.5))


def test_lanes_with_fewer_markers_are_padded_with_no_weight():
    measured = np.array([INSIDE, POST]) + 1e-3
    three = markers(names=["a", "b", "c"], positions=[INSIDE, POST, INSIDE])
    lanes = configuration_arrays(
        MESH,
        [
            Configuration("two", CLAMP, markers=markers(), measured=measured),
            Configuration("none", CLAMP),
            Configuration("three", CLAMP, markers=three),
        ],
    ).effectors
    assert lanes.weights.shape == (3, 3, 10)
    np.testing.assert_array_equal(lanes.measured[0, :2], measured)
    np.testing.assert_array_equal(
        lanes.inverse_std[0], [[1000.0] * 3] * 2 + [[0.0] * 3]
    )
    np.testing.assert_array_equal(lanes.weights[1], 0.0)
    # Followed, not measured: positions yes, weight in the fit no.
    np.testing.assert_array_equal(lanes.inverse_std[2], 0.0)
    np.testing.assert_allclose(lanes.weights[2].sum(axis=1), 1.0, rtol=1e-12)


def test_an_axis_that_is_not_measured_may_be_missing():
    measured = np.array([[0.05, np.nan, 0.0], [0.1, np.nan, 0.03]])
    seen = markers(axes="xz")
    configuration = Configuration("one", CLAMP, markers=seen, measured=measured)
    effectors = configuration_arrays(MESH, [configuration]).effectors
    assert np.isfinite(effectors.measured).all()
    np.testing.assert_array_equal(effectors.inverse_std[0, :, 1], 0.0)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"names": ["a", "a"]}, "marker 'a' .*another name"),
        ({"names": ["a"]}, r"positions .*\(1, 3\) .*got \(2, 3\)"),
        ({"positions": [INSIDE, [0, np.nan, 0]]}, "'b' .*three finite .*nan"),
        ({"std": 0.0}, r"std .*positive .*\[m\].* got 0"),
        ({"std": [1e-3, -1.0]}, "got -1; .*`axes`"),
        ({"std": [1e-3, np.inf]}, "got .*inf"),
        ({"std": [1e-3] * 3}, r"per marker \(2,\).* got shape \(3,\)"),
        ({"axes": "xw"}, "axes .*xyz.*'xw'"),
        ({"axes": ""}, "got ''"),
        ({"axes": "xx"}, "got 'xx'"),
    ],
)
def test_bad_markers(changed, message):
    with pytest.raises(ValueError, match=message):
        markers(**changed)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("measured", "message"),
    [
        ([INSIDE, [0, np.nan, 0]], "'b' .*'one' .*nan.* Leave"),
        ([INSIDE, [np.inf, 0, 0]], "'b' .*'one' .*inf.* Leave"),
        ([INSIDE], r"'one' .*\(a, b\).*\(2, 3\), got \(1, 3\)"),
        ([INSIDE, POST, POST], r"got \(3, 3\)"),
        ([[0.1, 0.2], [0.1, 0.2]], r"got \(2, 2\)"),
    ],
)
def test_bad_measurements(measured, message):
    with pytest.raises(ValueError, match=message):
        Configuration("one", CLAMP, markers=markers(), measured=np.array(measured))


def test_measured_without_markers():
    with pytest.raises(ValueError, match=r"'one' .*measured .*no markers"):
        Configuration("one", CLAMP, measured=np.array([INSIDE]))


def test_marker_far_outside_the_mesh():
    """The message names markers and configuration, and a unit that would mend it."""
    far = markers(positions=[INSIDE, [0.1, 0.01, 0.05]])
    with pytest.raises(ValueError, match=r"'one': .*'b' .*\(100, 10, 50\) mm .* 30 mm"):
        configuration_arrays(MESH, [Configuration("one", CLAMP, markers=far)])
    in_mm = markers(positions=1e3 * np.array([INSIDE, POST]))
    with pytest.raises(ValueError, match=r"'b' .*'a'.* not millimetres"):
        configuration_arrays(MESH, [Configuration("one", CLAMP, markers=in_mm)])
    for beside in ([0.1, 0.01, 0.05], [3.0, 0.2, 50.0], [0.0, 0.0, 0.05]):
        beside = markers(positions=[INSIDE, beside])
        with pytest.raises(ValueError, match=r"frame of the points\.$"):
            configuration_arrays(MESH, [Configuration("one", CLAMP, markers=beside)])
    near = markers(positions=far.positions, max_distance=0.04)
    configuration_arrays(MESH, [Configuration("one", CLAMP, markers=near)])


def test_measured_as_lists():
    """Whole numbers too: they become floats."""
    at = [[1, 0, 0], [2, 0, 0]]
    configuration = Configuration("one", CLAMP, markers=markers(), measured=at)
    assert isinstance(configuration.measured, np.ndarray)
    assert configuration.measured.dtype == np.float64
    np.testing.assert_array_equal(configuration.measured, at)


def test_a_single_marker_by_its_name():
    assert Markers("tip", [INSIDE], 1e-4).names == ("tip",)
