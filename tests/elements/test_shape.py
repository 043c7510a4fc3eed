import numpy as np
import pytest

from softcal_jax.elements import TET_EDGES, TET_FACES, shape_functions, shape_gradients

ELEMENTS = [(2, 2), (2, 3), (3, 3), (3, 6), (4, 4), (4, 10)]
EDGES = {2: [(0, 1)], 3: [(0, 1), (1, 2), (2, 0)], 4: list(TET_EDGES)}


def random_points(n_corners):
    """Barycentric points inside and outside the simplex."""
    xi = np.random.default_rng(0).uniform(-0.5, 1.2, (9, n_corners - 1))
    return np.concatenate([1.0 - xi.sum(axis=1, keepdims=True), xi], axis=1)


def nodes_of(n_corners, n_nodes):
    corners = np.eye(n_corners)
    mids = [(corners[i] + corners[j]) / 2 for i, j in EDGES[n_corners]]
    return np.vstack([corners, *mids])[:n_nodes]


@pytest.mark.parametrize(("n_corners", "n_nodes"), ELEMENTS)
def test_one_at_its_node_and_zero_at_the_others(n_corners, n_nodes):
    N = shape_functions(nodes_of(n_corners, n_nodes), n_nodes)
    np.testing.assert_array_equal(N, np.eye(n_nodes))


@pytest.mark.parametrize(("n_corners", "n_nodes"), ELEMENTS)
def test_reproduces_polynomials_of_its_order(n_corners, n_nodes):
    """Partition of unity, linear precision and, for quadratic ones, quadratic."""
    points, nodes = random_points(n_corners), nodes_of(n_corners, n_nodes)
    N = shape_functions(points, n_nodes)
    a = np.random.default_rng(1).normal(size=n_corners)
    for degree in range(2 if n_nodes == n_corners else 3):
        # Sums of at most ten products of numbers near one.
        np.testing.assert_allclose(
            N @ (nodes @ a) ** degree, (points @ a) ** degree, rtol=0, atol=1e-13
        )


@pytest.mark.parametrize(("n_corners", "n_nodes"), ELEMENTS)
def test_gradients_are_those_of_the_functions(n_corners, n_nodes):
    """Central differences are exact for a quadratic: only rounding / h remains."""
    points, h = random_points(n_corners), 1e-2
    dN = shape_gradients(points, n_nodes)
    assert dN.shape == (len(points), n_nodes, n_corners - 1)
    for j in range(n_corners - 1):
        step = np.zeros(n_corners)
        step[[0, j + 1]] = -h, h
        difference = shape_functions(points + step, n_nodes) - shape_functions(
            points - step, n_nodes
        )
        np.testing.assert_allclose(
            dN[:, :, j], difference / (2 * h), rtol=0, atol=1e-12
        )


def test_faces_look_outwards():
    X = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    for face in TET_FACES:
        a, b, c = X[list(face)]
        assert (
            np.cross(b - a, c - a) @ (X[list(face)].mean(axis=0) - X.mean(axis=0)) > 0
        )


def test_wrong_number_of_nodes():
    with pytest.raises(ValueError, match=r"4 corners .* 4 .* 10 .* got 8"):
        shape_functions(np.full((1, 4), 0.25), 8)
    with pytest.raises(ValueError, match=r"3 corners .* 6 .* got 5"):
        shape_gradients(np.full((1, 3), 1 / 3), 5)
