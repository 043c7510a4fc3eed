import numpy as np
import pytest

from softcal_jax.mesh import Grid, TetMesh, beam, locate, tets_of_voxels

N = 12


def bent(order):
    """A beam whose sides are curved where tets are quadratic, in a larger box."""
    mesh = beam(0.06, 0.02, 0.02, (3, 1, 1), order=order)
    x = mesh.points[:, 0]
    bow = np.stack([0 * x, 0 * x, 8.0 * x * (x - 0.06)], axis=1)
    return TetMesh(mesh.points + bow, mesh.tets)


@pytest.mark.parametrize("order", [1, 2])
def test_voxels_lie_where_points_are_located(order):
    mesh = bent(order)
    grid = Grid.around(mesh.points, N)
    owner = tets_of_voxels(mesh, grid)
    voxels = np.argwhere(np.ones((N,) * 3, bool))
    found = locate(mesh, grid.centres(voxels), max_distance=1.0)
    inside = found.distance == 0.0
    assert 0.2 < inside.mean() < 0.8
    np.testing.assert_array_equal(owner[tuple(voxels.T)] >= 0, inside)
    # A centre on a face between two tets may be in either.
    clear = inside & (found.barycentric.min(axis=1) > 1e-6)
    np.testing.assert_array_equal(owner[tuple(voxels[clear].T)], found.tet[clear])


def test_centres_and_the_voxels_at_them():
    """Centres stand at (i + 0.5) / n; ends of the box belong to the last voxel."""
    grid = Grid(np.array([-1.0, 0.0, 2.0]), np.array([1.0, 1.0, 6.0]), 4)
    centres = grid.centres(np.array([[0, 0, 0], [3, 1, 2]]))
    np.testing.assert_allclose(centres, [[-0.75, 0.125, 2.5], [0.75, 0.375, 4.5]])
    np.testing.assert_array_equal(grid.voxels_at(centres), [[0, 0, 0], [3, 1, 2]])
    np.testing.assert_array_equal(grid.voxels_at(grid.upper[None]), [[3, 3, 3]])


def test_many_tets_at_once(monkeypatch):
    """Cut into many parts or one, every pair of tet and voxel is looked at."""
    mesh = beam(0.06, 0.02, 0.02, (3, 2, 2))
    grid = Grid.around(mesh.points, N)
    whole = tets_of_voxels(mesh, grid)
    assert (whole >= 0).all()
    monkeypatch.setattr("softcal_jax.mesh._voxels._AT_ONCE", 50)
    np.testing.assert_array_equal(tets_of_voxels(mesh, grid) >= 0, True)
