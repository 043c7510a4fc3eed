"""Chambers and surface pressures: volumes, forces and the orientation of faces."""

import jax.numpy as jnp
import numpy as np
import pytest
from actuator_programs import (
    TURN,
    actuator_displacements,
    actuator_rows,
    area_vectors,
    arrays_of,
    bent,
)

from benchmarks._hollow import hollow, hollow_cube
from softcal_jax.actuators import Chamber, SurfacePressure
from softcal_jax.mesh import TetMesh, beam

each_order = pytest.mark.parametrize("order", [1, 2])
CHAMBER = Chamber("c", "cavity")


def with_cavity(mesh, faces):
    return TetMesh(mesh.points, mesh.tets, surface_groups={"cavity": faces})


@each_order
@pytest.mark.parametrize("cells", [1, 2])
def test_volume_of_a_cubic_cavity(cells, order):
    arrays = arrays_of(hollow_cube(cells, order), CHAMBER)
    np.testing.assert_allclose(arrays.rest, [(cells / (cells + 2)) ** 3], rtol=1e-13)


@each_order
def test_affine_map_scales_the_volume_by_its_determinant(order):
    mesh = hollow_cube(1, order)
    arrays = arrays_of(mesh, CHAMBER)
    assert abs(actuator_displacements(arrays, jnp.asarray(mesh.points))[0]) < 1e-16
    F = np.array([[1.3, 0.2, -0.1], [0.0, 0.9, 0.4], [0.3, -0.2, 1.1]])
    x = mesh.points @ F.T + [1.0, 2.0, 3.0]
    growth = (np.linalg.det(F) - 1.0) / 27.0
    delta = actuator_displacements(arrays, jnp.asarray(x))
    np.testing.assert_allclose(delta, [growth], rtol=1e-12)


def test_volume_of_a_curved_cavity_is_exact():
    """Quadratic faces follow a quadratic map of a cube of side s about the origin.

    X -> (1 + x / 2) X has the determinant (1 + x) (1 + x / 2)^2, whose even part is
    1 + 5/4 x^2: the volume grows by 5/48 s^5.
    """
    mesh = hollow_cube(2, order=2)
    x = mesh.points * (1.0 + 0.5 * mesh.points[:, :1])
    delta = actuator_displacements(arrays_of(mesh, CHAMBER), jnp.asarray(x))
    np.testing.assert_allclose(delta, [5.0 / 48.0 * 0.5**5], rtol=1e-12)


def test_a_cavity_may_touch_itself_along_an_edge():
    """Two cells of volume 1 that share an edge: four faces meet there."""
    full = beam(4.0, 4.0, 3.0, (4, 4, 3))
    lower = full.points.min(axis=0)
    cell = np.floor(full.points[full.tets].mean(axis=1) - lower)
    dropped = np.all(cell == 1, axis=1) | np.all(cell == [2, 2, 1], axis=1)
    arrays = arrays_of(hollow(full, dropped), CHAMBER)
    np.testing.assert_allclose(arrays.rest, [2.0], rtol=1e-13)


@pytest.mark.parametrize(("order", "rate"), [(1, 4.0), (2, 16.0)])
def test_volume_of_a_spherical_cavity(order, rate):
    """Flat faces miss the ball by h^2, quadratic ones by h^4."""

    def ball(points):
        reach = np.abs(points).max(axis=1, keepdims=True)
        return points * reach / np.linalg.norm(points, axis=1, keepdims=True)

    def error(cells):
        arrays = arrays_of(hollow_cube(cells, order, moved=ball), CHAMBER)
        radius = 0.5 * cells / (cells + 2)
        return 1.0 - float(arrays.rest[0]) / (4.0 / 3.0 * np.pi * radius**3)

    np.testing.assert_allclose(error(4) / error(8), rate, rtol=0.06)


@each_order
def test_rigid_motion_keeps_the_volume(order):
    mesh = hollow_cube(1, order)
    arrays = arrays_of(mesh, CHAMBER)
    x = jnp.asarray(mesh.points @ TURN.T + np.array([3.0, -1.0, 2.0]))
    delta = actuator_displacements(arrays, x)
    np.testing.assert_allclose(delta, [0.0], rtol=0, atol=1e-14)


def test_pressure_pushes_from_the_cavity_into_the_body():
    """Each flat face has area times normal, a third on each node, off the centre."""
    mesh = hollow_cube()
    faces = mesh.faces("cavity")
    x = bent(mesh.points)
    expected = np.zeros_like(x)
    # Normals of boundary faces point out of the body, into the cavity: the minus.
    np.add.at(expected, faces, -area_vectors(x, faces)[:, None] / 3.0)
    row = np.asarray(actuator_rows(arrays_of(mesh, CHAMBER), jnp.asarray(x)))[0]
    np.testing.assert_allclose(row, expected, rtol=0, atol=1e-15)
    wall = np.unique(faces)
    assert np.all(np.sum(row[wall] * x[wall], axis=1) > 0.0)


@each_order
def test_a_closed_surface_has_no_resultant(order):
    mesh = hollow_cube(2, order)
    x = bent(mesh.points)
    row = np.asarray(actuator_rows(arrays_of(mesh, CHAMBER), jnp.asarray(x)))[0]
    np.testing.assert_allclose(row.sum(axis=0), 0.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(np.cross(x, row).sum(axis=0), 0.0, rtol=0, atol=1e-15)


@each_order
def test_surface_pressure_on_a_closed_surface_is_a_chamber(order):
    """Both push on the body where lambda is positive: the forces are the same."""
    mesh = hollow_cube(1, order)
    x = jnp.asarray(bent(mesh.points))
    arrays = arrays_of(mesh, CHAMBER, SurfacePressure("p", "cavity"))
    chamber, pressure = np.asarray(actuator_rows(arrays, x))
    np.testing.assert_allclose(pressure, chamber, rtol=0, atol=1e-15)


@each_order
def test_surface_pressure_on_a_side(order):
    """On a flat side turned rigidly: area times minus the turned normal."""
    mesh = beam(0.4, 0.3, 0.2, (2, 2, 2), order=order)
    arrays = arrays_of(mesh, SurfacePressure("p", "x_max"))
    x = jnp.asarray(mesh.points @ TURN.T)
    force = np.asarray(actuator_rows(arrays, x))[0].sum(axis=0)
    np.testing.assert_allclose(force, -0.06 * TURN[:, 0], rtol=1e-12)


def test_surface_pressure_has_no_displacement():
    mesh = hollow_cube()
    arrays = arrays_of(mesh, SurfacePressure("p", "outer"), CHAMBER)
    np.testing.assert_array_equal(arrays.has_displacement, [False, True])
    np.testing.assert_array_equal(arrays.unilateral, [False, False])
    assert not arrays.symmetric
    assert arrays_of(mesh, CHAMBER).symmetric
    assert actuator_displacements(arrays, jnp.asarray(bent(mesh.points)))[0] == 0.0


@each_order
@pytest.mark.parametrize("kind", [Chamber, SurfacePressure])
def test_the_order_of_face_nodes_does_not_matter(kind, order):
    """A mesh file may list faces turned over, shuffled, and twice."""
    mesh = hollow_cube(1, order)
    faces = mesh.faces("cavity")
    swapped = [1, 0, 2] if order == 1 else [1, 0, 2, 3, 5, 4]
    turned = np.concatenate([faces[::-2][:, swapped], faces, faces[:1]])
    x = jnp.asarray(bent(mesh.points))
    rows = [
        actuator_rows(arrays_of(m, kind("a", "cavity")), x)
        for m in (mesh, with_cavity(mesh, turned))
    ]
    np.testing.assert_allclose(*rows, rtol=0, atol=1e-15)


def test_open_chamber():
    mesh = hollow_cube()
    opened = with_cavity(mesh, mesh.faces("cavity")[1:])
    message = r"'c': .*'cavity'.* 3 open edges.*\[.*\] m.* SurfacePressure"
    with pytest.raises(ValueError, match=message):
        arrays_of(opened, CHAMBER)


def test_surface_around_the_body():
    mesh = hollow_cube()
    with pytest.raises(ValueError, match=r"'outer'.*inner side.* -1 m3"):
        arrays_of(mesh, Chamber("c", "outer"))


@pytest.mark.parametrize("kind", [Chamber, SurfacePressure])
def test_faces_inside_the_body(kind):
    mesh = hollow_cube()
    inside = np.concatenate([mesh.faces("cavity"), mesh.tets[:1, :3]])
    for tet in mesh.tets:
        if len(set(tet[:3]) & set(mesh.faces("cavity").ravel())) == 1:
            inside[-1] = tet[:3]
    with pytest.raises(ValueError, match=r"1 of 13 faces .*'cavity'"):
        arrays_of(with_cavity(mesh, inside), kind("c", "cavity"))


def test_unknown_surface_is_suggested():
    with pytest.raises(ValueError, match=r"'cavty'.* mean 'cavity'"):
        arrays_of(hollow_cube(), Chamber("c", "cavty"))
