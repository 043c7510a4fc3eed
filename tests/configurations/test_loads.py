import jax.numpy as jnp
import numpy as np
import pytest
from problems import irregular_cube, nearest_node, straight_mid_nodes

from softcal_jax.configurations import (
    EdgeForce,
    NodalForces,
    PointForce,
    SurfaceForce,
    SurfaceTraction,
)
from softcal_jax.equilibrium import build_model, gravity_load
from softcal_jax.materials import Isotropic, StVenantKirchhoff
from softcal_jax.mesh import TetMesh, beam, to_quadratic

FORCE = (1.0, -2.0, 0.5)
each_order = pytest.mark.parametrize("order", [1, 2])


def box(order, cells=(4, 3, 2)):
    return beam(0.4, 0.3, 0.2, cells, order=order)


def moment(mesh, forces):
    return np.cross(mesh.points, forces).sum(axis=0)


@each_order
@pytest.mark.parametrize(
    ("load", "centre"),
    [
        (PointForce((0.11, 0.2, 0.03), FORCE), (0.11, 0.2, 0.03)),
        (SurfaceForce("x_max", FORCE), (0.4, 0.15, 0.1)),
        (
            SurfaceTraction("z_min", (1.0 / 0.12, -2.0 / 0.12, 0.5 / 0.12)),
            (0.2, 0.15, 0),
        ),
    ],
    ids=["point", "surface", "traction"],
)
def test_resultant_and_moment(order, load, centre):
    """The nodal forces have the total and the line of action of the load."""
    mesh = box(order)
    forces = load.nodal_forces(mesh)
    np.testing.assert_allclose(forces.sum(axis=0), FORCE, rtol=1e-12)
    np.testing.assert_allclose(
        moment(mesh, forces), np.cross(centre, FORCE), rtol=1e-12
    )


@each_order
def test_edge_force(order):
    """A line of nodes named by a group; edges of unequal length share by length."""
    mesh = box(order)
    graded = mesh.points.copy()
    graded[:, 1] = graded[:, 1] ** 2 / 0.3
    graded = TetMesh(graded, mesh.tets)
    mesh = graded if order == 1 else straightened(graded)
    line = np.flatnonzero((mesh.points[:, 0] == 0.4) & (mesh.points[:, 2] == 0.2))
    forces = EdgeForce(line, FORCE).nodal_forces(mesh)
    np.testing.assert_allclose(forces.sum(axis=0), FORCE, rtol=1e-12)
    centre = (0.4, 0.15, 0.2)
    np.testing.assert_allclose(
        moment(mesh, forces), np.cross(centre, FORCE), rtol=1e-12
    )
    assert set(np.flatnonzero(forces.any(axis=1))) == set(line)
    named = mesh.with_node_group("edge", line)
    np.testing.assert_array_equal(EdgeForce("edge", FORCE).nodal_forces(named), forces)


def straightened(mesh):
    """Mid nodes put back in the middle of their edges."""
    points = mesh.points.copy()
    points[mesh.tets[:, 4:]] = straight_mid_nodes(mesh)
    return TetMesh(points, mesh.tets)


def test_shares_of_a_quadratic_edge():
    """1/6 and 1/6 at the ends, 4/6 in the middle: Simpson's rule."""
    mesh = beam(1.0, 1.0, 1.0, (1, 1, 1), order=2)
    ends = np.array([nearest_node(mesh, (0, 0, 0)), nearest_node(mesh, (0, 1, 0))])
    forces = EdgeForce(ends, (0.0, 0.0, 6.0)).nodal_forces(mesh)[:, 2]
    middle = nearest_node(mesh, (0, 0.5, 0))
    np.testing.assert_allclose(forces[[*ends, middle]], [1.0, 1.0, 4.0], rtol=1e-14)
    assert np.count_nonzero(forces) == 3


def test_shares_of_a_quadratic_face():
    """A flat quadratic face loads its mid nodes only, a third each."""
    mesh = beam(1.0, 1.0, 1.0, (1, 1, 1), order=2)
    face = mesh.faces("x_max")[:1]
    mesh = mesh.with_surface_group("one", face)
    forces = SurfaceForce("one", (3.0, 0.0, 0.0)).nodal_forces(mesh)[:, 0]
    # Weights of the rule are kept to 15 digits.
    np.testing.assert_allclose(forces[face[0]], [0, 0, 0, 1, 1, 1], rtol=0, atol=1e-14)


@each_order
def test_traction_is_per_area_at_rest(order):
    forces = SurfaceTraction("x_max", (0.0, 0.0, -7.0)).nodal_forces(box(order))
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 0.0, -7.0 * 0.06], rtol=1e-12)


def test_point_force_on_a_node_is_that_node_s():
    mesh = box(2)
    node = nearest_node(mesh, (0.4, 0.3, 0.2))
    forces = PointForce((0.4, 0.3, 0.2), FORCE).nodal_forces(mesh)
    expected = np.zeros_like(mesh.points)
    expected[node] = FORCE
    np.testing.assert_allclose(forces, expected, rtol=0, atol=1e-12)


def test_nodal_forces_add_up_where_a_node_is_named_twice():
    forces = np.array([[1.0, 0, 0], [0, 2.0, 0], [0, 0, 3.0]])
    out = NodalForces(np.array([5, 7, 5]), forces).nodal_forces(box(1))
    np.testing.assert_array_equal(out[5], [1.0, 0, 3.0])
    np.testing.assert_array_equal(out[7], [0, 2.0, 0])
    assert np.count_nonzero(out) == 3


@each_order
def test_weight_of_a_body_with_two_densities(order):
    """Total and moment of the weight, density per tet, on irregular tets."""
    mesh = irregular_cube(2, order)
    centroid = mesh.points[mesh.tets[:, :4]].mean(axis=1)
    density = np.where(centroid[:, 0] < 0.5, 1000.0, 250.0)
    law = StVenantKirchhoff(Isotropic(1.0, 0.0))
    model = build_model(mesh, law, density=density)
    g = np.array([0.3, -9.81, 1.0])
    forces = np.asarray(gravity_load(model, jnp.asarray(g)))
    edges = mesh.points[mesh.tets[:, 1:4]] - mesh.points[mesh.tets[:, :1]]
    mass = np.linalg.det(edges) / 6.0 * density
    np.testing.assert_allclose(forces.sum(axis=0), mass.sum() * g, rtol=1e-12)
    centre = mass @ centroid / mass.sum()
    np.testing.assert_allclose(
        moment(mesh, forces), mass.sum() * np.cross(centre, g), rtol=1e-12
    )


def test_corners_of_a_quadratic_tet_carry_minus_a_twentieth():
    """Consistent body force: -1/20 at corners, 1/5 at mid nodes of the tet's mass."""
    X = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0.5, 0.3, 3]])
    linear = TetMesh(X, [[0, 1, 2, 3]])
    mesh = to_quadratic(linear)
    law = StVenantKirchhoff(Isotropic(1.0, 0.0))
    model = build_model(mesh, law, density=10.0)
    forces = gravity_load(model, jnp.array([0.0, 0.0, -2.0]))[mesh.tets[0]]
    expected = np.zeros((10, 3))
    # Volume 1, mass 10, weight 20.
    expected[:4, 2], expected[4:, 2] = 1.0, -4.0
    np.testing.assert_allclose(forces, expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(forces[:4, 2] / forces.sum(), -1 / 20, rtol=1e-13)


def test_bad_loads():
    mesh = box(1)
    with pytest.raises(ValueError, match=r"force .*finite .*\[N\].*nan"):
        PointForce((0.1, 0.1, 0.1), (0.0, np.nan, 0.0)).nodal_forces(mesh)
    with pytest.raises(ValueError, match=r"traction .*finite .*\[Pa\].*inf"):
        SurfaceTraction("x_max", (0.0, np.inf, 0.0)).nodal_forces(mesh)
    with pytest.raises(ValueError, match=r"force at \(.*\) mm.* 700 mm"):
        PointForce((0.1, 0.1, 0.9), FORCE).nodal_forces(mesh)
    with pytest.raises(ValueError, match=r"'x_mex'.*'x_max'\?"):
        SurfaceForce("x_mex", FORCE).nodal_forces(mesh)
    with pytest.raises(ValueError, match="unknown group 'edge'"):
        EdgeForce("edge", FORCE).nodal_forces(mesh)
    with pytest.raises(ValueError, match="at least two neighbours"):
        EdgeForce(np.array([0]), FORCE).nodal_forces(mesh)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("kind", "nodes", "force", "message"),
    [
        (EdgeForce, np.ones(60, bool), FORCE, "edge force needs .*flatnonzero"),
        (EdgeForce, [0, -1], FORCE, "edge force: node -1"),
        (NodalForces, [60], [FORCE], "nodal force: node 60"),
        (NodalForces, [-1], [FORCE], "nodal .* node -1.* 0 to 59"),
        (NodalForces, [4, 5], FORCE, r"shape \(2, 3\), got \(3,\)"),
        (NodalForces, [4, 5], [FORCE, (0.0, np.nan, 0.0)], "node 5 .*finite .*nan"),
    ],
)
def test_bad_nodes_and_forces(kind, nodes, force, message):
    with pytest.raises(ValueError, match=message):
        kind(nodes, force).nodal_forces(box(1))
