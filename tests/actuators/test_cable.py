import jax
import jax.numpy as jnp
import numpy as np
import pytest
from actuator_programs import (
    AXIS_LENGTH,
    TURN,
    actuator_displacements,
    actuator_rows,
    arrays_of,
    bent,
    curvature_entries,
    with_frames,
)
from wording import says

from softcal_jax.actuators import Cable, Guide, actuator_arrays
from softcal_jax.mesh import TetMesh, beam, locate, ring_around

PATH = ((0.0, 0.01, 0.02), (0.03, 0.03, 0.02), (0.1, 0.01, 0.0))
ORIGIN = np.array([0.2, 0.0, 0.1])


def body(order=1):
    return beam(0.1, 0.04, 0.04, (3, 2, 2), order=order)


def length(*points):
    return np.linalg.norm(np.diff(np.array(points), axis=0), axis=1).sum()


@pytest.mark.parametrize("order", [1, 2])
def test_straight_cable_shortens_with_the_body(order):
    """Stretch F leaves a cable from a to b the length |F (b - a)|, at any guides."""
    mesh = body(order)
    arrays = arrays_of(mesh, Cable("c", PATH))
    assert abs(actuator_displacements(arrays, jnp.asarray(mesh.points))[0]) < 1e-16
    F = np.diag([0.8, 1.1, 1.3]) + 0.1
    delta = actuator_displacements(arrays, jnp.asarray(mesh.points @ F.T))
    expected = length(*PATH) - length(*(np.array(PATH) @ F.T))
    np.testing.assert_allclose(delta, [expected], rtol=1e-12)


def test_shortening_is_positive():
    mesh = beam(1.0, 0.1, 0.1, (4, 1, 1))
    arrays = arrays_of(mesh, Cable("c", ((0.0, 0.05, 0.05), (1.0, 0.05, 0.05))))
    x = jnp.asarray(mesh.points * [0.9, 1.0, 1.0])
    np.testing.assert_allclose(actuator_displacements(arrays, x), [0.1], rtol=1e-12)


def test_tension_pulls_the_ends_together():
    """At its ends a cable pulls along itself; at a guide, by both of its parts."""
    mesh = body()
    nodes = [int(np.argmin(np.sum((mesh.points - p) ** 2, axis=1))) for p in PATH]
    points = mesh.points[nodes]
    arrays = arrays_of(mesh, Cable("c", tuple(points)))
    pull = np.asarray(actuator_rows(arrays, jnp.asarray(mesh.points)))[0]
    first, second = (d / np.linalg.norm(d) for d in np.diff(points, axis=0))
    np.testing.assert_allclose(
        pull[nodes], [first, second - first, -second], rtol=1e-12, atol=1e-13
    )
    others = np.delete(pull, nodes, axis=0)
    np.testing.assert_allclose(others, 0.0, rtol=0, atol=1e-13)


def test_guides_on_ground_and_on_a_rigid_body():
    """The body's guide follows its frame exactly; ground stays; only mesh bends."""
    mesh = body()
    points = with_frames(mesh, (ORIGIN, TURN))
    on_body, on_ground = np.array([0.25, 0.02, 0.03]), np.array([0.1, -0.3, 0.2])
    beside = on_body + np.array([0.0, 0.01, 0.0])
    guides = (
        Guide((0.05, 0.02, 0.02)),
        Guide(on_body, on="plate"),
        Guide(beside, on="plate"),
        Guide(on_ground, on="ground"),
        Guide(2.0 * on_ground, on="ground"),
    )
    arrays = actuator_arrays(mesh, points, (Cable("c", guides),), {"plate": 0})
    R, t = TURN.T @ TURN.T, np.array([0.1, 0.2, -0.3])
    x = points.copy()
    x[mesh.n_nodes :] = x[mesh.n_nodes :] @ R.T + t
    rest = [guide.point for guide in guides]
    now = [rest[0], *(p @ R.T + t for p in rest[1:3]), *rest[3:]]
    delta = actuator_displacements(arrays, jnp.asarray(x))
    np.testing.assert_allclose(delta, [length(*rest) - length(*now)], rtol=1e-12)
    # Parts of fixed length bring no clique: mesh-body and body-ground remain.
    assert len(arrays.clique_nodes()[0]) == 2


def test_cables_of_one_robot_are_told_apart():
    """Several cables, one group of cliques; each has its own displacement and row."""
    mesh = body()
    one, two = Cable("one", PATH), Cable("two", PATH[1:])
    both = arrays_of(mesh, one, two)
    x = jnp.asarray(bent(mesh.points))
    assert len(both.groups) == 1
    for function in (actuator_displacements, actuator_rows):
        alone = [function(arrays_of(mesh, cable), x) for cable in (one, two)]
        np.testing.assert_allclose(
            function(both, x), np.concatenate(alone), rtol=1e-14, atol=1e-16
        )


@pytest.mark.parametrize("order", [1, 2])
def test_clique_nodes_are_unique_but_for_padding(order):
    """Neighbouring guides share nodes, which must meet in one row of the clique."""
    mesh = body(order)
    ends = np.array([(0.051, 0.01, 0.011), (0.052, 0.01, 0.011)])
    arrays = arrays_of(mesh, Cable("c", tuple(ends)))
    (nodes,) = arrays.clique_nodes()
    x = jnp.asarray(bent(mesh.points))
    (entries,) = curvature_entries(arrays, x, jnp.ones(1))
    distinct, first = np.unique(nodes[0], return_index=True)
    carriers = locate(mesh, ends, max_distance=0.0).nodes
    assert distinct.size < carriers.size
    # Padding adds no node: the tangent would couple it to the cable.
    np.testing.assert_array_equal(distinct, np.unique(carriers))
    padding = np.delete(np.arange(nodes.shape[1]), first)
    blocks = np.asarray(entries).reshape(nodes.shape[1], 3, nodes.shape[1], 3)
    assert not blocks[padding].any()
    assert not blocks[:, :, padding].any()


def test_collapsed_segment_has_no_nan():
    """Both ends in one place: no direction, but finite rows and curvature."""
    mesh = body()
    arrays = arrays_of(mesh, Cable("c", PATH))
    x = jnp.zeros_like(jnp.asarray(mesh.points))
    entries = curvature_entries(arrays, x, jnp.ones(1))
    for value in jax.tree.leaves((actuator_rows(arrays, x), entries)):
        assert np.all(np.isfinite(value))


def test_unilateral():
    arrays = arrays_of(body(), Cable("c", PATH))
    np.testing.assert_array_equal(arrays.unilateral, [True])
    assert arrays.kinds[0].force_unit == "N"
    assert arrays.kinds[0].displacement_unit == "m"


@pytest.mark.parametrize(
    ("guides", "message"),
    [
        (PATH[:1], "'left' has 1 guide.* two"),
        ((PATH[0], PATH[1], PATH[1]), r"guides 1 and 2 .*\[0.03, 0.03, 0.02\] m"),
        ([Guide(p, "ground") for p in PATH[:2]], "all guides .*'ground'"),
        ([Guide(p, "plate") for p in PATH[:2]], "all guides .*'plate'"),
        (((0.0, 1.0), PATH[0]), r"point of a guide .*\[0. 1.\]"),
        (((0.0, 1.0, np.nan), PATH[0]), r"point of a guide .*nan"),
    ],
)
def test_bad_guides(unchecked, guides, message):
    with pytest.raises(ValueError, match=message):
        Cable("left", guides)


def test_a_name_is_needed():
    with pytest.raises(ValueError, match="cable needs a name"):
        Cable("", PATH)


def test_guide_outside_the_mesh():
    cable = Cable("left", (PATH[0], (0.2, 0.01, 0.02)))
    with pytest.raises(ValueError, match=r"'left', guide 1 at .* 100 mm"):
        arrays_of(body(), cable)


def test_guide_slightly_outside_is_carried():
    mesh = body()
    start = (-0.5e-3 * mesh.size, 0.01, 0.01)
    arrays = arrays_of(mesh, Cable("c", (start, PATH[2])))
    delta = actuator_displacements(arrays, jnp.asarray(1.5 * mesh.points))
    expected = -0.5 * length(start, PATH[2])
    np.testing.assert_allclose(delta, [expected], rtol=1e-12)


def channelled(order=1, n_sides=4):
    """A bar with a square hole along x, of 10 mm, or a groove that is open above."""
    bar = beam(0.06, 0.03, 0.03, (4, 3, 3), order=order)
    y, z = np.abs(bar.centroids[:, 1:].T - 0.015)
    upwards = bar.centroids[:, 2] > 0.015
    hole = (y < 0.005) & ((z < 0.005) | (upwards & (n_sides == 3)))
    used, tets = np.unique(bar.tets[~hole], return_inverse=True)
    return TetMesh(bar.points[used], tets.reshape(-1, bar.tets.shape[1]))


AXIS = ((0.0, 0.015, 0.015), (0.02, 0.016, 0.013), (0.06, 0.015, 0.015))
F = np.array([[0.9, 0.2, 0.1], [-0.1, 1.2, 0.3], [0.2, -0.3, 0.8]])


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("friction", [{}, {"friction": 0.2, "pulled_from": "last"}])
def test_guides_in_a_channel_follow_the_ring_of_wall(order, friction):
    """Exactly in a linear field; in others as its mean: an opposite bulge cancels."""
    mesh = channelled(order)
    arrays = arrays_of(mesh, Cable("c", AXIS, **friction))
    delta = actuator_displacements(arrays, jnp.asarray(mesh.points @ F.T))
    expected = length(*AXIS) - length(*(np.array(AXIS) @ F.T))
    np.testing.assert_allclose(delta, [expected], rtol=1e-10)
    ring = ring_around(mesh, np.array(AXIS[2]))
    assert ring is not None
    nodes, weights = ring
    away = mesh.points[nodes, 1:] - 0.015
    # Of the corners of the square hole, in the end face and one cell before it.
    np.testing.assert_allclose(np.abs(away), 0.005, rtol=1e-9)
    assert {*map(tuple, np.sign(away))} == {(a, b) for a in (-1, 1) for b in (-1, 1)}
    np.testing.assert_allclose(weights @ mesh.points[nodes], AXIS[2], atol=1e-15)
    assert weights.min() > -1e-12


def test_guides_in_a_groove_need_a_distance():
    """Open on one side, it is no channel; all of them are named at once."""
    mesh = channelled(n_sides=3)
    with pytest.raises(ValueError, match="max_distance") as refused:
        arrays_of(mesh, Cable("c", AXIS))
    assert says(str(refused.value), "guide 0 ... 5 mm ... guide 1 ... guide 2")
    arrays = arrays_of(mesh, Cable("c", AXIS, max_distance=0.006))
    delta = actuator_displacements(arrays, jnp.asarray(mesh.points @ F.T))
    expected = length(*AXIS) - length(*(np.array(AXIS) @ F.T))
    np.testing.assert_allclose(delta, [expected], rtol=1e-10)


def test_unknown_carrier_is_suggested():
    mesh = body()
    points = with_frames(mesh, (ORIGIN, TURN))
    cable = Cable("left", (PATH[0], Guide(PATH[1], on="plat")))
    with pytest.raises(ValueError, match=r"guide 1 'plat'.*mean 'plate'"):
        actuator_arrays(mesh, points, (cable,), {"plate": 0})


def test_axis_length_does_not_matter():
    """A body's guide has the same place whatever the length of the frame's axes."""
    mesh = body()
    points = with_frames(mesh, (ORIGIN, TURN))
    longer = points.copy()
    longer[-3:] = ORIGIN + 2.0 / AXIS_LENGTH * (points[-3:] - ORIGIN)
    cable = Cable("c", (PATH[0], Guide((0.3, 0.1, 0.2), on="plate")))
    rests = [
        actuator_arrays(mesh, p, (cable,), {"plate": 0}).rest for p in (points, longer)
    ]
    np.testing.assert_allclose(*rests, rtol=1e-13)
