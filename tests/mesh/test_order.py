import numpy as np
import pytest

from softcal_jax.elements import TET_EDGES
from softcal_jax.mesh import TetMesh, beam, to_linear, to_quadratic, volumes


def test_mid_nodes_are_shared_and_in_the_middle():
    linear = beam(0.1, 0.02, 0.03, (3, 2, 2))
    mesh = to_quadratic(linear)
    assert mesh.order == 2
    # The nodes of quadratic tets on this grid are those of the grid of half cells.
    assert mesh.n_nodes == 7 * 5 * 5
    assert len(np.unique(mesh.points.round(12), axis=0)) == mesh.n_nodes
    np.testing.assert_array_equal(mesh.tets[:, :4], linear.tets)
    X = mesh.points[mesh.tets]
    middle = X[:, np.array(TET_EDGES)].mean(axis=2)
    np.testing.assert_allclose(X[:, 4:], middle, rtol=0, atol=1e-17)
    np.testing.assert_allclose(volumes(mesh), volumes(linear), rtol=1e-12)


def test_groups_are_carried_and_come_back():
    linear = beam(0.1, 0.02, 0.03, (3, 1, 2)).with_tet_group("first", np.arange(6))
    linear = linear.with_node_group("first", linear.nodes("x_min"))
    mesh = to_quadratic(linear)
    assert mesh.faces("z_max").shape == (6, 6)
    np.testing.assert_array_equal(np.unique(mesh.faces("z_max")), mesh.nodes("z_max"))
    np.testing.assert_array_equal(
        mesh.nodes("first"), np.flatnonzero(mesh.points[:, 0] == 0)
    )
    back = to_linear(mesh)
    np.testing.assert_array_equal(back.points, linear.points)
    np.testing.assert_array_equal(back.tets, linear.tets)
    for name in linear.node_groups:
        np.testing.assert_array_equal(back.nodes(name), linear.nodes(name))
    for name in linear.surface_groups:
        np.testing.assert_array_equal(back.faces(name), linear.faces(name))
    np.testing.assert_array_equal(back.tets_of("first"), np.arange(6))


def test_two_sides_of_a_thin_mesh_stay_two_sides():
    """With one cell across, edges join the sides; the mid nodes stay free."""
    linear = beam(0.1, 0.02, 0.02, (3, 1, 1))
    both = np.vstack([linear.faces("y_min"), linear.faces("y_max")])
    named = linear.with_surface_group("sides", both)
    named = named.with_node_group("sides", np.unique(both))
    mesh = to_quadratic(named)
    y = mesh.points[mesh.nodes("sides"), 1]
    assert set(y.tolist()) == {0.0, 0.02}
    # Without the faces nothing says that the edges between are not meant.
    loose = to_quadratic(linear.with_node_group("sides", np.unique(both)))
    assert len(loose.nodes("sides")) == loose.n_nodes


def test_wrong_order():
    linear = beam(0.1, 0.02, 0.02, (1, 1, 1))
    with pytest.raises(ValueError, match="quadratic already"):
        to_quadratic(to_quadratic(linear))
    with pytest.raises(ValueError, match="linear already"):
        to_linear(linear)


def test_face_that_no_tet_has():
    mesh = TetMesh(
        np.vstack([np.zeros(3), np.eye(3), [[1, 1, 1]]]), [[0, 1, 2, 3], [1, 2, 3, 4]]
    ).with_surface_group("cut", [[0, 1, 4]])
    with pytest.raises(ValueError, match=r"'cut' .*not a face"):
        to_quadratic(mesh)
