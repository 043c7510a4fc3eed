import numpy as np
import pytest

from softcal_jax.mesh import beam
from softcal_jax.plotting import choose_view

DOWN = np.array([0.0, 0.0, -1.0])


def bent(mesh, along, direction):
    """Displacement that grows along an axis."""
    s = mesh.points[:, along] - mesh.points[:, along].min()
    return s[:, None] ** 2 * direction


def test_a_sagging_beam_is_seen_from_its_side():
    """Long axis and fall in the picture; x to the right, z up, a little of the end."""
    mesh = beam(0.1, 0.02, 0.02, (5, 1, 1))
    view = choose_view(mesh.points, bent(mesh, 0, DOWN))
    frame = np.stack([view.right, view.up, view.towards])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(frame), 1.0, rtol=1e-14)
    assert view.right[0] > 0.9
    assert view.up[2] > 0.9
    assert view.towards[1] < -0.85
    # From above, and from the side of the end that moves.
    assert view.towards[2] > 0.2
    assert view.towards[0] > 0.2


def test_what_moves_is_on_the_right():
    """Clamped at the other end, the same beam is seen from the other side."""
    mesh = beam(0.1, 0.02, 0.02, (5, 1, 1))
    mirrored = mesh.points * [-1.0, 1.0, 1.0]
    u = mesh.points[:, :1] ** 2 * DOWN
    view = choose_view(mirrored, u)
    assert view.right[0] < -0.9
    assert view.towards[1] > 0.85


def test_a_column_that_leans_stands_upright():
    mesh = beam(0.02, 0.02, 0.2, (1, 1, 5))
    lean = bent(mesh, 2, np.array([0.0, 1.0, 0.0]))
    view = choose_view(mesh.points, lean)
    assert view.up[2] > 0.9
    assert view.right[1] > 0.9


@pytest.mark.parametrize("motion", [np.zeros(3), np.array([1.0, 0.0, 0.0])])
def test_without_a_motion_across_the_axis(motion):
    """At rest, or pulled along the axis: seen from the side all the same."""
    mesh = beam(0.1, 0.02, 0.02, (5, 1, 1))
    view = choose_view(mesh.points, bent(mesh, 0, motion))
    assert view.right[0] > 0.9
    assert view.up[2] > 0.9


@pytest.mark.parametrize("turn", range(4))
def test_all_of_it_is_seen(turn):
    """Body at rest, deformed body and markers, for bodies in any attitude."""
    rng = np.random.default_rng(turn)
    mesh = beam(0.1, 0.02, 0.02, (5, 1, 1))
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    points, u = mesh.points @ Q.T, bent(mesh, 0, 5.0 * DOWN) @ Q.T
    markers = rng.normal(scale=0.1, size=(3, 3))
    view = choose_view(points, u, markers)
    flat = view.project(np.concatenate([points, points + u, markers]))
    half = 0.5 * np.array([view.width, view.height])
    np.testing.assert_allclose(flat.max(axis=0), half, rtol=1e-9)
    np.testing.assert_allclose(flat.min(axis=0), -half, rtol=1e-9)


def test_gravity_points_down():
    """Also where it is not along -z, and none is like -z."""
    mesh = beam(0.1, 0.02, 0.02, (5, 1, 1))
    sideways = bent(mesh, 0, np.array([0.0, -1.0, 0.0]))
    view = choose_view(mesh.points, sideways, gravity=(0.0, -9.81, 0.0))
    assert view.up[1] > 0.9
    for none in ((), np.zeros(3)):
        assert choose_view(mesh.points, gravity=none).up[2] > 0.9
