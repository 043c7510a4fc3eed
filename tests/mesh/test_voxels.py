import numpy as np
import pytest

from softcal_jax.mesh import Grid, TetMesh, beam, fill, locate

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
    filled = fill(mesh, grid)
    owner = np.full((N,) * 3, -1)
    owner[tuple(filled.voxels[filled.inside].T)] = filled.tets[filled.inside]
    voxels = np.random.default_rng(5).integers(0, N, (150, 3))
    place = locate(mesh, grid.centres(voxels), max_distance=1.0)
    inside = place.distance == 0.0
    assert 0.2 < inside.mean() < 0.8
    np.testing.assert_array_equal(owner[tuple(voxels.T)] >= 0, inside)
    # A centre on a face between two tets may be in either.
    clear = inside & (place.barycentric.min(axis=1) > 1e-6)
    np.testing.assert_array_equal(owner[tuple(voxels[clear].T)], place.tet[clear])


def test_centres_and_the_voxels_at_them():
    """Centres stand at (i + 0.5) / n; ends of the box belong to the last voxel."""
    grid = Grid(np.array([-1.0, 0.0, 2.0]), np.array([1.0, 1.0, 6.0]), 4)
    centres = grid.centres(np.array([[0, 0, 0], [3, 1, 2]]))
    np.testing.assert_allclose(centres, [[-0.75, 0.125, 2.5], [0.75, 0.375, 4.5]])
    np.testing.assert_array_equal(grid.voxels_at(centres), [[0, 0, 0], [3, 1, 2]])
    np.testing.assert_array_equal(grid.voxels_at(grid.upper[None]), [[3, 3, 3]])


def test_points_of_many_tets_at_once(monkeypatch):
    """Cut into many parts or one, every point of every tet is looked at."""
    mesh = bent(2)
    grid = Grid.around(mesh.points, N)
    whole = fill(mesh, grid)
    assert not whole.inside.all()
    monkeypatch.setattr("softcal_jax.mesh._generators._AT_ONCE", 50)
    cut = fill(mesh, grid)
    np.testing.assert_array_equal(cut.voxels, whole.voxels)
    np.testing.assert_array_equal(cut.inside, whole.inside)


def test_every_voxel_of_a_full_box():
    mesh = beam(0.06, 0.02, 0.02, (3, 2, 2))
    assert fill(mesh, Grid.around(mesh.points, N)).inside.sum() == N**3


@pytest.mark.parametrize("order", [1, 2])
def test_voxels_that_are_filled_in_part(order):
    """A plate thinner than a voxel, across all of them but in few of their centres."""
    plate = beam(0.06, 0.06, 0.001, (1, 1, 1), order=order)
    tilt = 0.4 * plate.points[:, [0]] * np.array([0.0, 0.0, 1.0])
    plate = TetMesh(plate.points + tilt, plate.tets)
    grid = Grid.around(plate.points, N)
    filled = fill(plate, grid)
    assert 0 < filled.inside.mean() < 0.7
    columns = np.unique(filled.voxels[:, :2], axis=0)
    assert len(columns) == N * N
    place = locate(plate, filled.places[::7], max_distance=1e-9)
    assert place.barycentric.min() > -1e-9
    np.testing.assert_array_equal(grid.voxels_at(filled.places), filled.voxels)
    middle = grid.centres(filled.voxels)[filled.inside]
    np.testing.assert_array_equal(filled.places[filled.inside], middle)
