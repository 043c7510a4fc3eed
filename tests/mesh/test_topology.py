import numpy as np
import pytest

from softcal_jax.mesh import (
    TetMesh,
    beam,
    boundary_faces,
    thin_share,
    to_quadratic,
    volumes,
)

POINTS = np.vstack([np.zeros(3), np.eye(3)])


def test_one_tet():
    mesh = TetMesh(POINTS, [[0, 1, 2, 3]])
    np.testing.assert_allclose(volumes(mesh), [1.0 / 6.0], rtol=1e-15)
    np.testing.assert_allclose(
        volumes(TetMesh(POINTS, [[0, 2, 1, 3]])), [-1.0 / 6.0], rtol=1e-15
    )
    assert {frozenset(face) for face in boundary_faces(mesh).tolist()} == {
        frozenset(face) for face in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))
    }


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("pattern", ["mirrored", "centred"])
def test_boundary_normals_point_outwards(order, pattern):
    """The divergence theorem gives the volume of the box from its faces alone."""
    mesh = beam(0.3, 0.2, 0.1, (3, 2, 1), order=order, pattern=pattern)
    corners = mesh.points[boundary_faces(mesh)[:, :3]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    outwards = (normals * (corners.mean(axis=1) - [0.15, 0.1, 0.05])).sum(axis=1)
    assert (outwards > 0).all()
    np.testing.assert_allclose(
        (normals * corners.mean(axis=1)).sum() / 3.0, 0.006, rtol=1e-12
    )


def test_mid_nodes_of_boundary_faces_lie_between_their_corners():
    mesh = beam(0.3, 0.2, 0.1, (3, 2, 1), order=2)
    X = mesh.points[boundary_faces(mesh)]
    middle = (X[:, [0, 1, 2]] + X[:, [1, 2, 0]]) / 2.0
    np.testing.assert_allclose(X[:, 3:], middle, rtol=0, atol=1e-16)


def test_volume_of_a_curved_tet_is_exact():
    """Mid nodes of the edges 0-1 and 0-3 are moved, by d along z and e along y.

    X = xi + 4 d L_0 L_1 e_z + 4 e L_0 L_3 e_y with L_0 = 1 - xi_1 - xi_2 - xi_3 has
    det dX/dxi = 1 - 4 d L_1 - 4 e L_3 + 16 d e L_0 L_1, and over the tet the integral
    of L_i is 1/24, that of L_i L_j is 1/120.
    """
    d, e = 0.03, 0.05
    mesh = to_quadratic(TetMesh(POINTS, [[0, 1, 2, 3]]))
    points = mesh.points.copy()
    points[mesh.tets[0, 4]] += [0.0, 0.0, d]
    points[mesh.tets[0, 7]] += [0.0, e, 0.0]
    exact = (1.0 - d - e) / 6.0 + 16.0 * d * e / 120.0
    curved = TetMesh(points, mesh.tets)
    np.testing.assert_allclose(volumes(curved), exact, rtol=1e-14)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("across", "least", "most"),
    [((1, 1), 1.0, 1.0), ((2, 2), 0.9, 1.0), ((3, 3), 0.0, 0.0), ((5, 5), 0.0, 0.0)],
)
def test_walls_of_two_tets_are_thin(across, least, most, order):
    """All of a slender beam but the middle of its ends."""
    size = [0.01 * n for n in across]
    share = thin_share(beam(0.1, *size, (10, *across), order=order))
    assert least - 1e-9 < share < most + 1e-9


def test_the_wall_of_a_cavity_is_thin_though_its_other_side_is_not():
    """Below it the block is four tets thick, and around its ends three."""
    full = beam(1.2, 0.7, 0.8, (12, 7, 8))
    x, y, z = full.centroids.T
    inside = (
        (np.abs(x - 0.6) < 0.3) & (np.abs(y - 0.35) < 0.05) & (np.abs(z - 0.6) < 0.1)
    )
    mesh = TetMesh(full.points, full.tets[~inside])
    assert thin_share(full) == 0.0
    assert 0.05 < thin_share(mesh) < 0.3
