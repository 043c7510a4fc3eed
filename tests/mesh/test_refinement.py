"""A mesh refined once: the same body, groups and displacements, in smaller tets."""

import numpy as np
import pytest
from refinement import refine

from softcal_jax.mesh import (
    TetMesh,
    beam,
    boundary_faces,
    check_mesh,
    to_quadratic,
    volumes,
)

each_order = pytest.mark.parametrize("order", [1, 2])
as_set = lambda faces: set(map(tuple, np.sort(faces, axis=1).tolist()))


def grouped(order):
    """A beam with a tet group and a node group of its own."""
    mesh = beam(0.1, 0.02, 0.03, (3, 1, 2), order=order)
    mesh = mesh.with_tet_group("first", np.arange(6))
    return mesh.with_node_group("end", mesh.nodes("x_min"))


@each_order
def test_eight_tets_fill_one(order):
    mesh = grouped(order)
    fine = refine(mesh)
    check_mesh(fine)
    assert (fine.order, fine.n_tets) == (order, 8 * mesh.n_tets)
    np.testing.assert_array_equal(fine.points[: mesh.n_nodes], mesh.points)
    parts = volumes(fine).reshape(-1, 8)
    np.testing.assert_allclose(parts.sum(axis=1), volumes(mesh), rtol=1e-12)
    # Only an octahedron may differ from regular ones, and all are about as large.
    assert parts.min() > 0.99 * parts.max()


@each_order
def test_groups_are_of_the_same_places(order):
    mesh = grouped(order)
    fine = refine(mesh)
    for name in mesh.surface_groups:
        axis, at = "xyz".index(name[0]), mesh.points[mesh.nodes(name)]
        plane = at[0, axis]
        on_it = np.flatnonzero(np.isclose(fine.points[:, axis], plane))
        np.testing.assert_array_equal(fine.nodes(name), on_it)
        assert as_set(fine.faces(name)) <= as_set(boundary_faces(fine))
        assert len(fine.faces(name)) == 4 * len(mesh.faces(name))
    np.testing.assert_array_equal(fine.nodes("end"), fine.nodes("x_min"))
    np.testing.assert_array_equal(fine.tets_of("first"), np.arange(48))


def test_curved_tets_stay_curved():
    """A bent bar: its volume by tets with curved sides, and by ever more of them."""
    straight = beam(1.0, 0.2, 0.2, (2, 1, 1), order=2)
    x, y, z = straight.points.T
    turned = np.stack([(1.0 + y) * np.sin(x), (1.0 + y) * np.cos(x) - 1.0, z], 1)
    curved = TetMesh(turned, straight.tets)
    fine = refine(curved)
    parts = volumes(fine).reshape(-1, 8).sum(axis=1)
    np.testing.assert_allclose(parts, volumes(curved), rtol=2e-3)
    # Straight sides between the same nodes would lose twenty times as much.
    chords = to_quadratic(TetMesh(curved.points, fine.tets[:, :4]))
    lost = abs(volumes(chords).sum() / volumes(curved).sum() - 1.0)
    assert abs(parts.sum() / volumes(curved).sum() - 1.0) < 0.05 * lost
