"""Values at quadrature points, recovered as a continuous field."""

import numpy as np
import pytest

from softcal_jax.elements import shape_functions, tet_rule
from softcal_jax.mesh import TetMesh, beam, boundary_faces, recovery, volumes

each_order = pytest.mark.parametrize("order", [1, 2])


def at_points(mesh):
    """Places of the quadrature points [m]."""
    N = shape_functions(tet_rule(mesh.order).barycentric, mesh.tets.shape[1])
    return np.einsum("qa,tai->tqi", N, mesh.points[mesh.tets]).reshape(-1, 3)


def recovered(mesh, values, deforming=None):
    """Values of the nodes of each tet, from those of the points."""
    all_tets = np.ones(mesh.n_tets, bool)
    r = recovery(mesh, all_tets if deforming is None else deforming)
    nodal = np.zeros(r.tets.max() + 1)
    np.add.at(nodal, r.node, r.weight * values[r.point])
    return nodal[r.tets]


def bent(order):
    """A mesh without symmetry, whose patches tell quadratic terms apart."""
    mesh = beam(0.1, 0.06, 0.04, (4, 3, 2), order=order)
    x, y, z = mesh.points.T
    return TetMesh(
        np.stack([x + 6 * y * z, y + 4 * x * x, z + 5 * x * y], 1), mesh.tets
    )


@each_order
def test_polynomials_of_the_order_are_kept(order):
    """Also where points lie on a sphere, or a wall is a hundred times thinner."""
    linear = lambda x: 0.3 + x @ [1.0, -2.0, 3.0]
    thin = beam(0.1, 0.1, 0.001, (4, 4, 1), order=order)
    for mesh in (beam(0.1, 0.03, 0.03, (3, 2, 2), order=order), thin, bent(order)):
        exact = linear(mesh.points[mesh.tets])
        np.testing.assert_allclose(recovered(mesh, linear(at_points(mesh))), exact)
    if order == 2:
        square = lambda x: np.sum(x * x, axis=-1) + x[..., 0] * x[..., 2]
        mesh = bent(2)
        nodal = recovered(mesh, square(at_points(mesh)))
        np.testing.assert_allclose(nodal, square(mesh.points[mesh.tets]), atol=1e-12)


@each_order
def test_parts_are_recovered_apart(order):
    mesh = beam(0.1, 0.03, 0.03, (4, 2, 2), order=order)
    first = mesh.centroids[:, 0] < 0.05
    of_tet = np.where(first, 1.0, 5.0)
    mesh = mesh.with_tet_group("first", np.flatnonzero(first))
    n_qp = len(at_points(mesh)) // mesh.n_tets
    nodal = recovered(mesh, np.repeat(of_tet, n_qp))
    np.testing.assert_allclose(nodal, np.broadcast_to(of_tet[:, None], nodal.shape))


@each_order
def test_rigid_tets_take_no_part(order):
    """Their stress is none; the faces between them and the others are a boundary."""
    mesh = beam(0.1, 0.03, 0.03, (4, 2, 2), order=order)
    soft = mesh.centroids[:, 0] < 0.05
    x = at_points(mesh)
    n_qp = len(x) // mesh.n_tets
    values = np.where(np.repeat(soft, n_qp), x[:, 1], np.nan)
    nodal = recovered(mesh, values, soft)[soft]
    np.testing.assert_allclose(nodal, mesh.points[mesh.tets[soft]][:, :, 1], atol=1e-15)
    r = recovery(mesh, soft)
    assert np.all(r.volumes[~soft] == 0.0)
    assert np.all(soft[r.face_tet])
    outer = boundary_faces(TetMesh(mesh.points, mesh.tets[soft]))
    np.testing.assert_array_equal(r.face_nodes, outer)


@each_order
def test_faces_are_where_they_are(order):
    """Each point on its face, with the normal outwards and a third of the volume."""
    mesh = beam(0.1, 0.06, 0.04, (4, 3, 2), order=order)
    r = recovery(mesh, np.ones(mesh.n_tets, bool))
    x = at_points(mesh).reshape(mesh.n_tets, -1, 3)[r.face_tet]
    corners = mesh.points[r.face_nodes[:, :3]]
    away = corners.mean(axis=1) - x.mean(axis=1)
    assert np.all(np.sum(away * r.face_normal, axis=1) > 0.0)
    np.testing.assert_allclose(3.0 * r.face_volume, volumes(mesh)[r.face_tet])
    if order == 1:  # a constant is all that is known
        np.testing.assert_array_equal(r.face_from_points, 1.0)
        return
    at = np.einsum("fkq,fqi->fki", r.face_from_points, x)
    shares = np.full((3, 3), 1.0 / 6.0) + np.eye(3) / 2.0
    expected = np.einsum("kc,fci->fki", shares, corners)
    # In any order, since a face may begin at any of its corners.
    off = np.linalg.norm(at[:, :, None] - expected[:, None], axis=3)
    assert np.max(off.min(axis=2)) < 1e-15


@pytest.mark.parametrize(("order", "n"), [(1, 1), (2, 1), (2, 4)])
def test_a_part_too_small_for_a_patch(order, n):
    """Recovered as well as its points allow: four of them give a linear field."""
    mesh = beam(0.1, 0.03, 0.03, (4, 2, 2), order=order)
    small = np.arange(n)
    nodal = recovered(mesh.with_tet_group("small", small), at_points(mesh)[:, 0])
    assert np.all(np.isfinite(nodal))
    if order == 2:
        exact = mesh.points[mesh.tets[small]][:, :, 0]
        np.testing.assert_allclose(nodal[small], exact, atol=1e-15)
