"""Where the deforming part of a body is held, and which way is out."""

import numpy as np
import pytest

from softcal_jax.mesh import beam
from softcal_jax.unknowns._unknowns import outward_motion


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("side", "normal"), [("x_min", -1.0), ("x_max", 1.0)])
def test_a_clamped_end_points_out_of_the_beam(order, side, normal):
    """The normal on the face, half of it in the middle of edges that leave it."""
    mesh = beam(0.1, 0.02, 0.02, (4, 1, 1), order=order)
    held = np.zeros(mesh.n_nodes, bool)
    held[mesh.nodes(side)] = True
    motion = outward_motion(mesh, held)
    np.testing.assert_allclose(motion[held], [[normal, 0.0, 0.0]] * held.sum())
    end = mesh.points[held][0, 0]
    away = np.abs(mesh.points[:, 0] - end)
    halfway = np.isclose(away, 0.0125)
    assert np.any(halfway) == (order == 2)
    np.testing.assert_array_equal(
        motion[halfway], [[0.5 * normal, 0.0, 0.0]] * halfway.sum() or motion[:0]
    )
    np.testing.assert_array_equal(motion[away > 0.02], 0.0)


def test_a_gripped_end_is_held_where_the_grip_ends():
    """A quarter of the beam is held with its inside: what is free begins behind it."""
    mesh = beam(0.1, 0.02, 0.02, (8, 2, 2), order=1)
    held = mesh.points[:, 0] < 0.0251
    motion = outward_motion(mesh, held)
    front = held & (mesh.points[:, 0] > 0.0249)
    np.testing.assert_allclose(motion[front], [[-1.0, 0.0, 0.0]] * front.sum())
    np.testing.assert_array_equal(motion[~front], 0.0)


def test_nothing_held_and_everything_held():
    mesh = beam(0.1, 0.02, 0.02, (2, 1, 1), order=1)
    for held in (False, True):
        nodes = np.full(mesh.n_nodes, held)
        np.testing.assert_array_equal(outward_motion(mesh, nodes), 0.0)


def test_a_curved_grip_has_normals_of_its_own():
    """A corner that is held on two sides goes out along both."""
    mesh = beam(0.02, 0.02, 0.02, (2, 2, 2), order=1)
    held = np.zeros(mesh.n_nodes, bool)
    for side in ("x_min", "y_min"):
        held[mesh.nodes(side)] = True
    motion = outward_motion(mesh, held)
    np.testing.assert_allclose(np.linalg.norm(motion[held], axis=1), 1.0)
    edge = np.all(mesh.points[:, :2] == 0.0, axis=1)
    assert np.all(motion[edge][:, :2] < -0.3)
