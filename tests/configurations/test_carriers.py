"""Markers on posts that follow a patch of the body."""

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

POST = [[0.1, 0.01, 0.028]]


def effectors(mesh, **options):
    markers = Markers(("post",), POST, max_distance=0.01, **options)
    c = Configuration("one", (Support("x_min"),), markers=markers)
    return configuration_arrays(mesh, [c]).effectors


def position(arrays, x):
    return np.sum(np.asarray(arrays.weights[0, 0])[:, None] * x[arrays.nodes[0, 0]], 0)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("radius", [0.0, 0.018])
def test_post_follows_an_affine_motion_exactly(order, radius):
    """A rigid motion above all: that is what a post on a rigid base does."""
    mesh = beam(0.1, 0.02, 0.02, (8, 2, 2), order=order)
    arrays = effectors(mesh, base_radius=radius)
    turn = Rotation.from_rotvec([0.4, -1.0, 0.2]).as_matrix()
    for A in (turn, turn @ (np.eye(3) + 0.1 * np.diag([1.0, -0.5, 0.3]))):
        x = mesh.points @ A.T + [0.1, 0.2, 0.3]
        expected = A @ POST[0] + [0.1, 0.2, 0.3]
        np.testing.assert_allclose(position(arrays, x), expected, atol=1e-13)


def test_patch_smooths_a_local_dent_that_one_tet_follows():
    mesh = beam(0.1, 0.02, 0.02, (20, 4, 4))
    x = mesh.points.copy()
    foot = np.argmin(np.linalg.norm(x - [0.1, 0.01, 0.02], axis=1))
    x[foot, 2] -= 1e-4
    moved = {
        radius: abs(position(effectors(mesh, base_radius=radius), x)[2] - POST[0][2])
        for radius in (0.0, 0.012)
    }
    assert moved[0.0] > 0.99e-4  # the whole dent
    assert moved[0.012] < 0.5e-4


def test_base_without_enough_nodes_is_refused():
    mesh = beam(0.1, 0.02, 0.02, (4, 1, 1))
    with pytest.raises(ValueError, match=r"'post': .* 0 .*base_radius 2 mm"):
        effectors(mesh, base_radius=0.002)


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_base_radius_must_be_a_length(value):
    with pytest.raises(ValueError, match=f"base_radius .*finite.* got {value:g}"):
        Markers(("post",), POST, base_radius=value)
