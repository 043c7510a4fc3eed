import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree
from wording import saying

from softcal_jax.elements import shape_functions
from softcal_jax.mesh import (
    TetMesh,
    beam,
    boundary_faces,
    check_mesh,
    locate,
    to_quadratic,
)

BOX = np.array([0.1, 0.02, 0.03])


def _bent(n=6):
    """A quadratic beam bent to a quarter of a circle or so: every tet is curved."""
    mesh = beam(*BOX, (n, 2, 2), order=2)
    angle, radius = mesh.points[:, 0] / 0.06, 0.06 - mesh.points[:, 2]
    arc = [radius * np.sin(angle), mesh.points[:, 1], 0.06 - radius * np.cos(angle)]
    bent = TetMesh(np.stack(arc, axis=1), mesh.tets)
    check_mesh(bent)
    return bent


def _linear_field(x):
    return x @ np.array([[1.0, -2.0], [0.5, 3.0], [-4.0, 0.25]]) + [7.0, -1.0]


@pytest.mark.parametrize(
    "mesh", [beam(*BOX, (5, 2, 3)), beam(*BOX, (3, 1, 2), order=2)]
)
def test_inside_and_outside_a_box(mesh):
    points = np.random.default_rng(0).uniform(-0.01, BOX + 0.01, (60, 3))
    place = locate(mesh, points, max_distance=0.02)
    # The distance to a box has a closed form.
    gap = np.linalg.norm(points - np.clip(points, 0.0, BOX), axis=1)
    assert 0 < (gap > 0).sum() < 60
    np.testing.assert_allclose(place.distance, gap, rtol=1e-12, atol=1e-16)
    np.testing.assert_allclose(place.weights.sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(place.interpolate(mesh.points), points, atol=1e-15)
    np.testing.assert_allclose(
        place.interpolate(_linear_field(mesh.points)), _linear_field(points), rtol=1e-12
    )
    inside = place.barycentric.min(axis=1) >= -1e-9
    np.testing.assert_array_equal(inside, gap == 0)
    np.testing.assert_array_equal(place.nodes, mesh.tets[place.tet])


def test_quadratic_field_is_exact_inside_a_quadratic_tet():
    mesh = beam(*BOX, (3, 1, 2), order=2)
    field = lambda x: x[:, 0] ** 2 - 3.0 * x[:, 1] * x[:, 2]
    points = np.random.default_rng(1).uniform(0.0, BOX, (20, 3))
    place = locate(mesh, points, max_distance=0.0)
    np.testing.assert_allclose(
        place.interpolate(field(mesh.points)), field(points), rtol=0, atol=1e-16
    )


def test_outside_follows_the_tangent_not_the_parabola():
    """A post above a bent beam keeps to the rotation of its foot.

    For u_z = x^2 the value at height h over the top of the box is still that of the
    foot, and for u = z^2 it grows linearly: H^2 + 2 H h.
    """
    mesh = beam(*BOX, (3, 1, 2), order=2)
    foot, h = np.array([0.047, 0.008, 0.03]), 0.02
    place = locate(mesh, foot[None] + np.array([0.0, 0.0, h]), max_distance=0.021)
    np.testing.assert_allclose(place.distance, [h], rtol=1e-12)
    x2, z2 = place.interpolate(mesh.points[:, [0, 2]] ** 2)[0]
    np.testing.assert_allclose(x2, 0.047**2, rtol=1e-12)
    np.testing.assert_allclose(z2, 0.03**2 + 2 * 0.03 * h, rtol=1e-12)


def test_every_curved_tet_finds_its_own_points():
    mesh = _bent()
    rng = np.random.default_rng(2)
    tet = np.arange(mesh.n_tets)
    barycentric = rng.dirichlet(np.ones(4), mesh.n_tets)
    N = shape_functions(barycentric, 10)
    points = np.einsum("na,nai->ni", N, mesh.points[mesh.tets])
    place = locate(mesh, points, max_distance=0.0)
    np.testing.assert_array_equal(place.tet, tet)
    np.testing.assert_allclose(place.barycentric, barycentric, rtol=0, atol=1e-10)
    np.testing.assert_allclose(place.weights, N, rtol=0, atol=1e-10)


def test_outside_a_curved_mesh():
    """The distance meets that to a fine sampling of the surface, from below."""
    mesh = _bent()
    lower, upper = mesh.points.min(axis=0), mesh.points.max(axis=0)
    points = np.random.default_rng(3).uniform(lower - 0.01, upper + 0.01, (40, 3))
    place = locate(mesh, points, max_distance=0.1)
    outside = place.distance > 0
    assert 10 < outside.sum() < 40
    n = 40
    grid = [(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]
    N = shape_functions(np.array(grid) / n, 6)
    surface = (N @ mesh.points[boundary_faces(mesh)]).reshape(-1, 3)
    sampled, _ = KDTree(surface).query(points[outside])
    assert (place.distance[outside] <= sampled + 1e-15).all()
    # Faces are about 15 mm wide, so samples are 0.4 mm apart, and a foot between them
    # is at most 0.3 mm from the next: farther by at most sqrt(d^2 + 0.3^2).
    assert (sampled <= np.hypot(place.distance[outside], 3e-4)).all()
    np.testing.assert_allclose(place.interpolate(mesh.points), points, atol=1e-14)
    np.testing.assert_allclose(
        place.interpolate(_linear_field(mesh.points)), _linear_field(points), rtol=1e-11
    )


def test_around_one_tet_its_faces_edges_and_corners_are_nearest():
    """Against a fine sampling of its faces; with mid nodes it is the same tet."""
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(4, 3))
    if np.linalg.det(corners[1:] - corners[0]) < 0.0:
        corners = corners[[1, 0, 2, 3]]
    mesh, n = TetMesh(corners, [[0, 1, 2, 3]]), 100
    points = rng.normal(scale=3.0, size=(120, 3))
    grid = [(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]
    samples = np.array(grid) / n @ corners[boundary_faces(mesh)]
    sampled, _ = KDTree(samples.reshape(-1, 3)).query(points)
    place = locate(mesh, points, max_distance=20.0)
    outside = place.distance > 0.0
    gap, sampled = place.distance[outside], sampled[outside]
    assert np.all(gap <= sampled + 1e-12)
    spacing = np.linalg.norm(corners[:, None] - corners, axis=2).max() / n
    assert np.all(sampled <= np.hypot(gap, spacing) + spacing)
    homogeneous = np.vstack([place.foot[outside].T, np.ones(len(gap))])
    of_foot = np.linalg.solve(np.vstack([corners.T, np.ones(4)]), homogeneous)
    assert {*np.sum(of_foot > 1e-9, axis=0)} == {1, 2, 3}
    curved = locate(to_quadratic(mesh), points, max_distance=20.0)
    np.testing.assert_allclose(curved.distance, place.distance, rtol=0, atol=1e-7)


def test_inside_a_bulge_beyond_every_node():
    """An edge with ends at 0 and -0.3 and mid node at -0.3 dips to -0.3375."""
    mesh = to_quadratic(TetMesh(np.vstack([np.zeros(3), np.eye(3)]), [[0, 1, 2, 3]]))
    points = mesh.points.copy()
    points[1] += [0.0, 0.0, -0.3]
    points[mesh.tets[0, [4, 5, 8]]] += [[0, 0, -0.3], [0, 0, -0.15], [0, 0, -0.15]]
    bulged = TetMesh(points, mesh.tets)
    check_mesh(bulged)
    barycentric = np.array([[0.249, 0.749, 0.001, 0.001]])
    point = shape_functions(barycentric, 10)[0] @ points[mesh.tets[0]]
    assert point[2] < points[:, 2].min() - 0.03
    place = locate(bulged, [point], max_distance=0.0)
    np.testing.assert_allclose(place.barycentric, barycentric, rtol=0, atol=1e-12)


def test_a_node_an_edge_and_a_corner():
    mesh = beam(*BOX, (2, 2, 2))
    points = np.vstack([mesh.points[13], BOX, BOX + np.array([0.003, 0.004, 0.0])])
    place = locate(mesh, points, max_distance=0.01)
    np.testing.assert_allclose(place.distance, [0.0, 0.0, 0.005], atol=1e-15)
    np.testing.assert_allclose(place.interpolate(mesh.points), points, atol=1e-15)
    one = place.weights[0].argmax()
    assert place.nodes[0, one] == 13
    np.testing.assert_allclose(place.weights[0, one], 1.0, rtol=1e-12)


def test_jax_fields_are_taken():
    mesh = beam(*BOX, (2, 2, 2))
    place = locate(mesh, [BOX / 3.0], max_distance=0.0)
    value = place.interpolate(jnp.asarray(mesh.points[:, 0]))
    np.testing.assert_allclose(value, BOX[0] / 3.0, rtol=1e-6)


def test_no_points():
    place = locate(beam(*BOX, (1, 1, 1)), np.empty((0, 3)), max_distance=0.0)
    assert place.weights.shape == (0, 4)


def test_far_points_are_named():
    mesh = beam(*BOX, (2, 2, 2))
    points = [[0.05, 0.01, 0.01], [0.05, 0.01, 0.04], [0.05, 0.01, 0.05]]
    message = "point 2 ... (50, 10, 50) mm ... 20 mm ... 5 mm ... point 1 ... frame"
    with pytest.raises(ValueError, match=saying(message)):
        locate(mesh, points, max_distance=0.005)
    with pytest.raises(ValueError, match=r"^c .* 5 mm\. .*do b\. "):
        locate(mesh, points, max_distance=0.005, names=["a", "b", "c"])


@pytest.mark.parametrize(
    ("points", "max_distance", "message"),
    [
        ([[0.0, np.nan, 0.0]], 0.1, r"point 0 .*\[0\.0, nan, 0\.0\]"),
        ([0.0, 0.0, 0.0], 0.1, r"shape \(n, 3\), got \(3,\)"),
        ([[0.0, 0.0, 0.0]], -1.0, r"max_distance .* 0 m, got -1\.0"),
        ([[0.0, 0.0, 0.0]], np.nan, "max_distance .* 0 m, got nan"),
    ],
)
def test_bad_calls(points, max_distance, message):
    with pytest.raises(ValueError, match=message):
        locate(beam(*BOX, (1, 1, 1)), points, max_distance=max_distance)
