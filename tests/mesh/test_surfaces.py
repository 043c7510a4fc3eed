"""Surfaces from a point: what a walk reaches, one face, and the wall of a cavity."""

import numpy as np
import pytest

from benchmarks._hollow import hollow, hollow_cube
from softcal_jax.mesh import (
    TetMesh,
    beam,
    boundary_faces,
    face_shares,
    select_cavity,
    select_face,
    select_reachable,
)

each_order = pytest.mark.parametrize("order", [1, 2])
BEAM = (0.4, 0.2, 0.1)


def area(mesh, faces):
    return face_shares(mesh, faces).sum()


def corners(faces):
    return {tuple(sorted(f)) for f in faces[:, :3].tolist()}


def open_block(order=1):
    """A cube of side 1 whose cavity, 1/3 wide, opens in the side x = 0."""
    full = beam(1.0, 1.0, 1.0, (3, 3, 3), origin=(0.0, -0.5, -0.5))
    x, *across = full.centroids.T
    middle = np.abs(across).max(axis=0) < 1 / 6
    mesh = hollow(full, middle & (x < 2 / 3), order)
    X, faces = mesh.points, boundary_faces(mesh)
    inlet_side = faces[(X[faces, 0] < 1e-9).all(axis=1)]
    return mesh.with_surface_group("inlet side", inlet_side)


@each_order
def test_a_face_of_a_box_ends_at_its_edges(order):
    mesh = beam(*BEAM, (4, 2, 1), order=order)
    for point, name in (((0.1, 0.2, 0.05), "y_max"), ((0.4, 0.05, 0.03), "x_max")):
        assert corners(select_face(mesh, point)) == corners(mesh.faces(name))


def test_a_round_wall_is_one_face():
    """A block bent to a tube of 24 sides: walls go on, ends and faces stop."""
    mesh = beam(1.0, 0.1, 0.3, (24, 1, 2))
    angle = 2.0 * np.pi * 0.9 * mesh.points[:, 0]
    radius = 1.0 + mesh.points[:, 1]
    x = np.stack([radius * np.cos(angle), radius * np.sin(angle), mesh.points[:, 2]], 1)
    tube = TetMesh(x, mesh.tets[:, [0, 1, 3, 2]], {}, mesh.surface_groups)
    inner = select_face(tube, (np.cos(1.0), np.sin(1.0), 0.1))
    assert corners(inner) == corners(mesh.faces("y_min"))


def test_faces_of_a_cad_model_are_taken_as_they_are():
    """Two sides of a block that are one face of the model."""
    mesh = beam(*BEAM, (4, 2, 1))
    both = np.concatenate([mesh.faces("y_max"), mesh.faces("x_max")])
    mesh = mesh.with_surface_group("face 3", both)
    assert corners(select_face(mesh, (0.1, 0.2, 0.05))) == corners(both)


def test_a_walk_ends_at_sharp_edges_and_at_groups():
    mesh = beam(*BEAM, (4, 2, 1))
    everything = select_reachable(mesh, (0.1, 0.2, 0.05))
    assert corners(everything) == corners(boundary_faces(mesh))
    side = select_reachable(mesh, (0.1, 0.2, 0.05), angle=np.deg2rad(80.0))
    assert corners(side) == corners(mesh.faces("y_max"))
    ends = ["x_min", "x_max"]
    around = select_reachable(mesh, (0.1, 0.2, 0.05), stop_at=ends)
    assert area(mesh, around) == pytest.approx(2 * 0.4 * (0.2 + 0.1))
    assert not corners(around) & corners(mesh.faces("x_min"))


@each_order
def test_wall_of_a_closed_cavity(order):
    mesh = hollow_cube(1, order)
    wall = select_cavity(mesh, (0.05, -0.02, 0.01))
    assert corners(wall) == corners(mesh.faces("cavity"))


@each_order
def test_wall_of_an_open_cavity(order):
    """It ends at the side in which the opening lies, wherever the point is."""
    mesh = open_block(order)
    for x in (0.05, 0.3, 0.6):
        wall = select_cavity(mesh, (x, 0.03, 0.01), stop_at=["inlet side"])
        assert corners(wall) == corners(mesh.faces("cavity"))
    assert area(mesh, wall) == pytest.approx(4 * 2 / 9 + 1 / 9)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda m: select_face(m, (0.2, 0.2, 0.1)),
            r"\(200, 200, 100\) mm .* 2 surfaces",
        ),
        (
            lambda m: select_face(m, (100.0, 200.0, 50.0)),
            r"\(0, 0, 0\) m to \(400, 200, 100\) mm; .*length unit",
        ),
        (
            lambda m: select_reachable(m, (0.4, 0.1, 0.05), stop_at=["x_max"]),
            r"not to be entered \('x_max'\)",
        ),
        (
            lambda m: select_reachable(m, (0.2, 0.2, 0.05), stop_at=["x_mux"]),
            "'x_mux'.* mean 'x_max'",
        ),
        (
            lambda m: select_reachable(m, (0.2, 0.2, 0.05), angle=4.0),
            "angle .* 0 and 180 degrees, got 229",
        ),
        (
            lambda m: select_cavity(m, (0.2, 0.1, 0.05)),
            r"\(200, 100, 50\) mm .*in the body",
        ),
        (
            lambda m: select_cavity(m, (0.2, 0.1, 0.5)),
            "no cavity .* 0 % .*stop_at.*'x_max'",
        ),
    ],
)
def test_bad_calls(call, message):
    with pytest.raises(ValueError, match=message):
        call(beam(*BEAM, (4, 2, 1)))


def test_an_open_cavity_asks_where_its_opening_lies():
    mesh = open_block()
    with pytest.raises(ValueError, match="name the surface"):
        select_cavity(mesh, (0.5, 0.0, 0.0))
