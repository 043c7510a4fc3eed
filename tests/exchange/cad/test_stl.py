"""Meshes of STL surfaces: clean ones by gmsh, others by fTetWild."""

import meshio
import numpy as np
import pytest
from exchange.cad.cad_models import CAVITY, FINGER, MIDDLE, modelled, write_finger

from softcal_jax.exchange.cad import mesh_cad
from softcal_jax.mesh import (
    MeshWarning,
    boundary_faces,
    face_shares,
    select_cavity,
    select_face,
    volumes,
)

MM = 1e-3
SIZE = 5 * MM


def box(*sides):
    return np.prod(sides) * MM ** len(sides)


@pytest.fixture(scope="module")
def stl(tmp_path_factory):
    path = tmp_path_factory.mktemp("stl") / "finger.stl"
    return write_finger(path, is_open=False, size=8.0)


@pytest.fixture(scope="module")
def holed(stl):
    """The same with a triangle missing, and all others turned outwards."""
    mesh = mesh_cad(stl, size=2 * SIZE, length_unit="mm", order=1)
    path = stl.with_name("holed.stl")
    triangles = [("triangle", boundary_faces(mesh)[1:])]
    meshio.Mesh(mesh.points / MM, triangles).write(path)
    return path


def test_a_closed_surface_with_a_cavity(stl):
    mesh = mesh_cad(stl, size=SIZE, length_unit="mm")
    assert mesh.order == 2
    assert volumes(mesh).sum() == pytest.approx(box(*FINGER) - box(*CAVITY), rel=1e-6)
    assert len(mesh.surface_groups) == 12
    tip = select_face(mesh, (FINGER[0] * MM, 5 * MM, 5 * MM))
    assert face_shares(mesh, tip).sum() == pytest.approx(box(*FINGER[1:]), rel=1e-6)
    wall = select_cavity(mesh, MIDDLE)
    sides = 2 * sum(np.prod(CAVITY) / a for a in CAVITY) * MM**2
    assert face_shares(mesh, wall).sum() == pytest.approx(sides, rel=1e-6)


def test_round_walls_are_one_face(tmp_path):
    """Gmsh cuts a tube in patches, which are joined again."""
    with modelled(tmp_path / "tube.stl", size=2.0) as shape:
        outer = shape.addCylinder(0, 0, 0, 0, 0, 30, 8)
        shape.cut([(3, outer)], [(3, shape.addCylinder(0, 0, 0, 0, 0, 30, 5))])
    mesh = mesh_cad(tmp_path / "tube.stl", size=3 * MM, length_unit="mm")
    assert len(mesh.surface_groups) == 4
    wall = select_face(mesh, (0.0, 8 * MM, 15 * MM))
    expected = 2 * np.pi * 8 * 30 * MM**2
    assert face_shares(mesh, wall).sum() == pytest.approx(expected, rel=0.03)


def test_the_unit_is_needed(stl):
    with pytest.raises(ValueError, match=r"STL .*unit.* None"):
        mesh_cad(stl, size=SIZE)
    with pytest.raises(ValueError, match=r"STL .*unit.* 'milli'"):
        mesh_cad(stl, size=SIZE, length_unit="milli")


def test_what_is_no_surface(tmp_path):
    bad = tmp_path / "bad.stl"
    bad.write_bytes(b"solid nothing\nendsolid nothing\n")
    with pytest.raises(ValueError, match=r"bad\.stl: .*(0 tri|read as STL)"):
        mesh_cad(bad, size=SIZE, length_unit="mm")
    bad.write_bytes(bytes(60))
    with pytest.raises(ValueError, match=r"bad\.stl: .*(0 tri|read as STL)"):
        mesh_cad(bad, size=SIZE, length_unit="mm")


def test_a_hole_without_ftetwild(holed, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pytetwild", None)
    with pytest.raises(ValueError, match=r"gmsh .* 3 edges .* pytetwild"):
        mesh_cad(holed, size=SIZE, length_unit="mm")


@pytest.mark.slow
def test_a_hole_is_filled_by_ftetwild_and_said(holed, tmp_path, monkeypatch):
    """And nothing is left in the folder of the program."""
    pytest.importorskip("pytetwild")
    monkeypatch.chdir(tmp_path)
    with pytest.warns(MeshWarning, match=r"3 edges .*fTetWild filled"):
        mesh = mesh_cad(holed, size=SIZE, length_unit="mm")
    assert not list(tmp_path.iterdir())
    expected = box(*FINGER) - box(*CAVITY)
    assert volumes(mesh).sum() == pytest.approx(expected, rel=0.01)
    wall = select_cavity(mesh, MIDDLE)
    sides = 2 * sum(np.prod(CAVITY) / a for a in CAVITY) * MM**2
    assert face_shares(mesh, wall).sum() == pytest.approx(sides, rel=0.02)
