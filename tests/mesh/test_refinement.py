"""A mesh refined once: the same body, groups and displacements, in smaller tets."""

import jax.random as jr
import numpy as np
import pytest

from softcal_jax.elements import shape_functions
from softcal_jax.mesh import (
    TetMesh,
    beam,
    boundary_faces,
    check_mesh,
    finer,
    refine,
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


@each_order
def test_displacements_of_the_coarse_mesh_are_among_those_of_the_finer(order):
    """At any point of any tet, whichever mesh is asked."""
    mesh = grouped(order)
    fine = finer(mesh)
    u = np.asarray(jr.normal(jr.key(0), (mesh.n_nodes, 3)))
    both = np.concatenate([u, fine.carried(u)])
    own = np.array([[0.1, 0.2, 0.3, 0.4], [0.7, 0.1, 0.1, 0.1]])
    n = fine.mesh.tets.shape[1]
    seen = np.einsum("qa,tai->tqi", shape_functions(own, n), both[fine.mesh.tets])
    at = own @ fine.corners
    N = shape_functions(at, mesh.tets.shape[1])
    exact = np.einsum("tqa,tai->tqi", N, u[mesh.tets[fine.parent]])
    np.testing.assert_allclose(seen, exact, atol=1e-13)


@each_order
def test_faces_and_held_nodes(order):
    mesh = grouped(order)
    fine = finer(mesh)
    assert as_set(fine.faces(boundary_faces(mesh))) == as_set(boundary_faces(fine.mesh))
    held = np.isin(np.arange(mesh.n_nodes + 4), mesh.nodes("x_min"))
    all_held = np.flatnonzero(fine.with_new(held, fine.among(held)))
    np.testing.assert_array_equal(all_held, fine.mesh.nodes("x_min"))
    # Nodes after those of the mesh, the frames of bodies, move on.
    frame = np.array([0, mesh.n_nodes])
    np.testing.assert_array_equal(fine.nodes(frame), [0, fine.mesh.n_nodes])


def test_what_two_sides_do_not_decide_is_not_held():
    """One cell across: quadratic tets are free between two held sides."""
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1), order=2)
    sides = np.union1d(mesh.nodes("y_min"), mesh.nodes("y_max"))
    held = np.isin(np.arange(mesh.n_nodes), sides)
    fine = finer(mesh)
    y = fine.mesh.points[mesh.n_nodes :][fine.among(held), 1]
    assert set(y.round(12).tolist()) == {0.0, 0.02}
