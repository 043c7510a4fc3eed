import numpy as np
import pytest
from wording import saying

from softcal_jax.mesh import (
    Annulus,
    Box,
    Cylinder,
    Plane,
    Sphere,
    beam,
    boundary_faces,
    select_faces,
    select_nodes,
)

MESH = beam(0.1, 0.02, 0.02, (10, 2, 2))


def test_box_takes_its_sides():
    nodes = select_nodes(MESH, Box((0.0, 0.0, 0.0), (0.01, 0.02, 0.0)))
    np.testing.assert_array_equal(
        nodes, np.flatnonzero((MESH.points[:, 0] < 0.015) & (MESH.points[:, 2] == 0))
    )
    assert len(nodes) == 6


def test_box_may_be_open():
    half = select_nodes(MESH, Box((-np.inf, -np.inf, 0.01), (np.inf, np.inf, np.inf)))
    assert len(half) == 11 * 3 * 2


def test_plane_and_its_tolerance():
    tilted = Plane(point=(0.05, 0.0, 0.0), normal=(2.0, 0.0, 0.0))
    assert len(select_nodes(MESH, tilted)) == 9
    thick = Plane((0.05, 0.0, 0.0), (2.0, 0.0, 0.0), tolerance=0.0101)
    assert len(select_nodes(MESH, thick)) == 27
    diagonal = Plane((0.0, 0.0, 0.0), (0.0, 1.0, -1.0))
    x = MESH.points[select_nodes(MESH, diagonal)]
    assert len(x) == 33
    np.testing.assert_allclose(x[:, 1], x[:, 2], rtol=0, atol=1e-15)


def test_sphere():
    nodes = select_nodes(MESH, Sphere((0.0, 0.0, 0.0), 0.0101))
    assert len(nodes) == 4


def test_cylinder_and_annulus():
    """About the long axis of the beam; its cells have sides of 10 mm."""
    axis = (0.0, 0.01, 0.01), (0.05, 0.01, 0.01)
    assert len(select_nodes(MESH, Cylinder(*axis, 0.005))) == 6
    assert len(select_nodes(MESH, Cylinder(*axis, 0.0101))) == 6 * 5
    assert len(select_nodes(MESH, Cylinder(*axis, 0.005, tolerance=0.0051))) == 6 * 5
    assert len(select_nodes(MESH, Annulus(*axis, 0.005, 0.0101))) == 6 * 4
    ring = Annulus((-1e-6, 0.01, 0.01), (1e-6, 0.01, 0.01), 0.009, 0.015)
    assert len(select_nodes(MESH, ring)) == 8


@pytest.mark.parametrize(
    ("point", "from_tube", "from_solid"),
    [
        ((1.5, 0.0, 1.5), 0.0, 0.0),
        ((0.0, 0.5, 1.0), 0.5, 0.0),
        ((0.0, 3.0, 1.0), 1.0, 1.0),
        ((0.0, 0.0, -2.0), np.sqrt(5.0), 2.0),
        ((6.0, 0.0, 6.0), 5.0, 5.0),
    ],
)
def test_distance_from_round_regions(point, from_tube, from_solid):
    """Between radii of 1 and 2, or within 2, along z from 0 to 3."""
    tube = Annulus((0, 0, 0), (0, 0, 3), 1.0, 2.0)
    solid = Cylinder((0, 0, 0), (0, 0, 3), 2.0)
    for region, expected in ((tube, from_tube), (solid, from_solid)):
        np.testing.assert_allclose(region.distance(np.array([point])), [expected])


def test_regions_combine_as_predicates():
    box, ball = Box((0, 0, 0), (0.02, 0.02, 0.02)), Sphere((0, 0, 0), 0.0101)
    nodes = select_nodes(MESH, lambda x: box(x) & ~ball(x))
    assert len(nodes) == 27 - 4


def test_faces_need_all_their_nodes():
    np.testing.assert_array_equal(
        select_faces(MESH, Plane((0, 0, 0), (1, 0, 0))), MESH.faces("x_min")
    )
    everything = select_faces(MESH, lambda x: np.ones(len(x), dtype=bool))
    np.testing.assert_array_equal(everything, boundary_faces(MESH))
    quadratic = beam(0.1, 0.02, 0.02, (10, 2, 2), order=2)
    faces = select_faces(quadratic, Plane((0.1, 0, 0), (1, 0, 0)))
    assert faces.shape == (8, 6)


def test_empty_selection_says_how_far():
    message = (
        "no node ... sphere ... (0, 0, 0) m to (100, 20, 20) mm ... 200 mm ... unit"
    )
    with pytest.raises(ValueError, match=saying(message)):
        select_nodes(MESH, Sphere((0.4, 0.0, 0.0), 0.1))
    with pytest.raises(ValueError, match=r"no boundary face .* 9 nodes"):
        select_faces(MESH, Plane((0.05, 0.0, 0.0), (1.0, 0.0, 0.0)))
    with pytest.raises(ValueError, match=r"lambda.* \(100, 20, 20\) mm\.$"):
        select_nodes(MESH, lambda x: x[:, 0] > 1.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Box((0, 0, 1), (1, 1, 0)), r"box .*lower \[0\. 0\. 1\.\]"),
        (lambda: Box((0, 0), (1, 1, 0)), r"lower .*three numbers.*\[0\. 0\.\]"),
        (lambda: Plane((0, 0, 0), (0, 0, 0)), "normal .*not be zero"),
        (lambda: Plane((0, np.nan, 0), (0, 0, 1)), "point .*three finite.*nan"),
        (lambda: Sphere((0, 0, 0), -1.0), r"radius .*\[m\], got -1\.0"),
        (lambda: Cylinder((0, 0, 0), (0, 0, 0), 1.0), r"start and end .*\(0, 0, 0\)"),
        (lambda: Cylinder((0, 0, 0), (0, 0, 1), 0.0), r"radius .*0\.0 and 0\.0"),
        (lambda: Annulus((0, 0, 0), (0, 0, 1), 2.0, 1.0), r"radius .*2\.0 and 1\.0"),
        (lambda: select_nodes(MESH, lambda x: x[:, 0]), "99 points, got float64"),
        (lambda: select_nodes(MESH, lambda x: x > 0), r"99 points, .*\(99, 3\)"),
    ],
)
def test_bad_calls(call, message):
    with pytest.raises(ValueError, match=message):
        call()
