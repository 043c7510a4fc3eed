import numpy as np
import pytest

from softcal_jax.mesh import TetMesh, beam, tessellate, volumes


def enclosed_volume(points, triangles):
    """By the divergence theorem; positive if the normals point outwards."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    return np.sum(a * np.cross(b, c)) / 6.0


@pytest.mark.parametrize(("order", "triangles"), [(1, 108), (2, 108 * 16)])
def test_a_closed_surface_with_outward_normals(order, triangles):
    mesh = beam(0.03, 0.03, 0.03, (3, 3, 3), order=order)
    surface = tessellate(mesh)
    assert surface.triangles.shape == (triangles, 3)
    points = surface.interpolate(mesh.points)
    np.testing.assert_allclose(
        enclosed_volume(points, surface.triangles), 0.03**3, rtol=1e-12
    )
    # Every edge has two triangles, which run along it in opposite directions: no
    # point is there twice.
    t = surface.triangles
    edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]).tolist()
    edges = [tuple(edge) for edge in edges]
    assert len(set(edges)) == len(edges)
    assert {(b, a) for a, b in edges} == set(edges)


def test_a_quadratic_side_is_followed():
    """Chords of a parabola: a quarter of the length leaves a sixteenth of the error."""
    mesh = beam(0.1, 0.02, 0.02, (2, 1, 1), order=2)
    # Only the top is bent: its error has nothing to cancel with.
    x, _, z = mesh.points.T
    bulge = np.stack([0 * x, 0 * x, 0.5 * x**2 * (z / 0.02) ** 2], axis=1)
    bent = TetMesh(mesh.points + bulge, mesh.tets)
    exact = volumes(bent).sum()
    fine = tessellate(mesh)
    volume = enclosed_volume(fine.interpolate(bent.points), fine.triangles)
    corners = tessellate(TetMesh(mesh.points, mesh.tets[:, :4]))
    coarse = enclosed_volume(corners.interpolate(bent.points), corners.triangles)
    ratio = (coarse - exact) / (volume - exact)
    np.testing.assert_allclose(ratio, 16.0, rtol=1e-6)


def test_nodal_values_are_interpolated_by_the_element():
    """A quadratic field is met exactly at all points of the surface."""
    mesh = beam(0.1, 0.02, 0.02, (2, 1, 1), order=2)
    surface = tessellate(mesh)
    X = surface.interpolate(mesh.points)
    np.testing.assert_allclose(
        surface.interpolate(mesh.points**2), X**2, rtol=1e-12, atol=1e-15
    )
