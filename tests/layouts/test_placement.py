"""Places by hand numbers, and where the markers of a stretched bar see its modulus."""

import numpy as np
import pytest
import scipy.linalg
from bars import MID, TIP, bar, pose, stretched
from wording import saying

from softcal_jax.fields import ControlPoints
from softcal_jax.layouts import LayoutWarning, place_control_points
from softcal_jax.layouts._placement import _separation, pivoted
from softcal_jax.mesh import TetMesh

CORNERS = 0.1 * np.array([[-1, -1, -1], [3, -1, -1], [-1, 3, -1], [-1, -1, 3]])


def chain(x):
    """Equal tets that do not touch, with their centroids at (x, 0, 0)."""
    centroids = np.outer(x, [1.0, 0.0, 0.0])
    points = (centroids[:, None] + CORNERS).reshape(-1, 3)
    return TetMesh(points, np.arange(len(points)).reshape(-1, 4))


@pytest.mark.parametrize(
    ("n", "x"),
    # The middle is 5.9; the place nearest to it 6; farthest from there 0; and so on.
    [
        (1, [6]),
        (2, [0, 10.5]),
        (3, [0, 10.5, 6]),
        (4, [0, 10.5, 6, 4]),
        (5, [0, 10.5, 6, 4, 9]),
    ],
)
def test_farthest_by_hand(n, x):
    points = place_control_points(chain([0, 4, 6, 9, 10.5]), n)
    np.testing.assert_allclose(points.positions[:, 0], x, atol=1e-14)
    np.testing.assert_allclose(points.positions[:, 1:], 0.0, atol=1e-14)
    assert points.names == tuple(f"CP {i + 1}" for i in range(n))


def test_options_reach_the_control_points():
    points = place_control_points(bar((4, 1, 1)).mesh, 3, axes="xz", region="tip")
    assert points.axes == "xz"
    assert np.all(points.positions[:, 0] > 0.05)


def test_numbering_of_the_tets_does_not_matter():
    mesh = bar((4, 2, 2)).mesh
    order = np.random.default_rng(0).permutation(mesh.n_tets)
    # An even permutation of the corners: the same tet, other rounding.
    other = TetMesh(mesh.points, mesh.tets[order][:, [1, 2, 0, 3]])
    for n in (1, 2, 7):
        a, b = (place_control_points(m, n).positions for m in (mesh, other))
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_along_one_axis_they_stay_near_the_middle_of_the_others():
    """Distance along x alone: the ends. Of the tets there the nearest to the axis.

    Centroids of Kuhn's tets lie at 1/4, 1/2 and 3/4 of their cell: 0.00625 from an end.
    """
    points = place_control_points(bar((4, 2, 2)).mesh, 2, axes="x").positions
    np.testing.assert_allclose(points[:, 0], [0.09375, 0.00625], atol=1e-12)
    off = np.linalg.norm(np.asarray(points)[:, 1:] - 0.01, axis=1)
    assert np.all(off < 0.006)


def place(n, configurations, **options):
    model = bar((8, 2, 2))
    options = {"axes": "x", "fields": "E", **options}
    return place_control_points(
        model.mesh,
        n,
        method="sensitivity",
        model=model,
        configurations=configurations,
        **options,
    )


def test_no_point_beyond_a_marker_half_way():
    """A stretched bar: what lies beyond the marker does not move it."""
    x = place(1, stretched(MID)).positions[:, 0]
    assert 0.0 < x[0] < 0.05
    with pytest.warns(LayoutWarning, match=r"only 1 of 3 .*Add"):
        x = place(3, stretched(MID)).positions[:, 0]
    # A patch, a cell of 12.5 mm long, may reach across the marker.
    assert np.all(x < 0.05 + 0.0125)


def test_points_see_independent_directions():
    """With a marker on the tip as well, each half has a direction of its own."""
    x = np.asarray(place(2, stretched(MID, TIP)).positions[:, 0])
    assert x.min() < 0.05 < x.max()
    # The root moves both markers, the tip one: it comes second.
    assert x[0] < x[1]


def test_sizes_weigh_the_fields():
    """Bending under its own weight: the modulus counts most at the clamp.

    The density counts most at the tip, whose weight has the longest lever.
    """
    bent = pose("bent", (TIP,))
    for E, density, near in ((1e5, 1.0, 0.0), (1.0, 1e3, 0.1)):
        x = place(1, bent, fields={"E": E, "density": density}).positions[0, 0]
        assert abs(x - near) < 0.03


def places(x):
    return np.asarray(x, float)[:, None] / np.ptp(x)


def test_without_a_distance_it_is_scipys_pivoted_qr():
    A = np.random.default_rng(1).normal(size=(6, 15))
    A /= np.linalg.norm(A, axis=0).max()
    _, _, pivots = scipy.linalg.qr(A, pivoting=True, mode="economic")
    chosen, rank = pivoted(places(range(15)), A[:, :, None], 5, 0.0)
    assert chosen == list(pivots[:5])
    assert rank == 5


def test_a_point_takes_the_directions_of_all_its_fields():
    """Patch 0 sees two directions with its two fields, so patch 1 is no news."""
    blocks = np.zeros((3, 3, 2))
    blocks[0, 0, 0] = blocks[1, 0, 1] = np.sqrt(0.5)
    blocks[1, 1, 0], blocks[2, 2, 0] = 0.8, 0.3
    assert pivoted(places([0, 1, 2]), blocks, 2, 0.0) == ([0, 2], 2)


@pytest.mark.parametrize("seed", range(5))
def test_the_default_distance_leaves_room(seed):
    random = np.random.default_rng(seed)
    there = places(random.random(30))
    blocks = random.random((1, 30, 1))
    for n in (1, 2, 5, 9):
        chosen, _ = pivoted(there, blocks, n, 0.5 * _separation(there, n))
        assert len(set(chosen)) == n


@pytest.mark.parametrize(
    ("n", "options", "text"),
    [
        (0, {}, "control points ... 1, got 0"),
        (7, {"region": "tip"}, "7 ... 'tip' ... 6 tets"),
        (13, {}, "13 ... mesh ... 12 tets"),
        (2, {"method": "farthst"}, "'farthst' ... mean 'farthest'"),
        (2, {"region": "tipp"}, "'tipp' ... mean 'tip'"),
        (2, {"axes": "w"}, "axes ... 'w'"),
        (9, {"axes": "x"}, "9 ... 6 different places ... along x"),
        (2, {"method": "sensitivity"}, "model, configurations and fields"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_bad_input(n, options, text):
    with pytest.raises(ValueError, match=saying(text)):
        place_control_points(bar((2, 1, 1)).mesh, n, **options)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"fields": {"E": -1.0}}, "variation of E ... -1"),
        ({"fields": "G"}, "field 'G' ... law.E"),
        ({"configurations": pose("at rest", (MID,), g=0.0)}, "not see ... loaded"),
        ({"model": bar((8, 1, 1))}, "another mesh ... model.mesh"),
    ],
)
def test_bad_input_of_sensitivity(options, text):
    model = bar((8, 2, 2))
    given = {"model": model, "configurations": stretched(MID), "fields": "E"}
    with pytest.raises(ValueError, match=saying(text)):
        place_control_points(
            model.mesh, 2, method="sensitivity", **{**given, **options}
        )


def test_result_is_control_points():
    assert isinstance(place_control_points(bar((2, 1, 1)).mesh, 1), ControlPoints)
