"""Meshes of STL surfaces: clean ones by gmsh, others by fTetWild."""

import itertools
import re

import meshio
import numpy as np
import pytest
from exchange.cad.cad_models import CAVITY, FINGER, MIDDLE, modelled, write_finger
from scipy.spatial import ConvexHull, KDTree
from wording import says

from softcal_jax.exchange.cad import _mesh, mesh_cad, read_stl
from softcal_jax.exchange.cad._surface import turned_outwards
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


def box_triangles(low, high, outwards=True):
    """The twelve triangles of a box, and its eight corners."""
    points = np.array(list(itertools.product(*zip(low, high, strict=True))))
    hull = ConvexHull(points)
    a, b, c = np.moveaxis(points[hull.simplices], 1, 0)
    inwards = np.sum(np.cross(b - a, c - a) * hull.equations[:, :3], axis=1) < 0.0
    triangles = hull.simplices.copy()
    triangles[inwards == outwards] = triangles[inwards == outwards, ::-1]
    return points, triangles


def write_boxes(path, *boxes, flipped=()):
    points = np.concatenate([points for points, _ in boxes])
    shift = np.cumsum([0, *(len(points) for points, _ in boxes)])
    triangles = np.concatenate(
        [part + more for (_, part), more in zip(boxes, shift[:-1], strict=True)]
    )
    triangles[list(flipped)] = triangles[list(flipped), ::-1]
    meshio.Mesh(points, [("triangle", triangles)]).write(path)
    return path


OUTER = (0.0, 0.0, 0.0), (30.0, 20.0, 20.0)
INNER = (10.0, 5.0, 5.0), (20.0, 15.0, 15.0)
ISLAND = (13.0, 8.0, 8.0), (17.0, 12.0, 12.0)


@pytest.mark.parametrize(
    ("flipped", "n"), [(range(5), 5), (range(12), 12), (range(12, 24), 0), ([], 0)]
)
def test_turned_triangles_are_turned_back_and_said(flipped, n, tmp_path):
    """Some, or all; the box has a cavity, whose wall the file turns inwards or not."""
    boxes = box_triangles(*OUTER), box_triangles(*INNER, outwards=False)
    path = write_boxes(tmp_path / "box.stl", *boxes, flipped=flipped)
    surface, notes = turned_outwards(read_stl(path))
    assert surface.volume == pytest.approx(30 * 20 * 20 - 10**3)
    of_cavity = list(flipped)[:1] == [12]
    alike = of_cavity or n == 12
    assert len(notes) == bool(n) + alike
    if n:
        assert says(notes[0], f"{n} of 24 triangles ... turned over")
    if alike:
        assert says(notes[-1], "(15, 10, 10) ... within another ... cavity ... delete")


def test_a_box_in_a_box_is_said(tmp_path):
    """Filled between both, as one whose inner triangles are turned as a cavity's."""
    boxes = box_triangles(*OUTER), box_triangles(*INNER)
    path = write_boxes(tmp_path / "box.stl", *boxes)
    with pytest.warns(MeshWarning, match=r"box\.stl: .*\(15, 10, 10\).*cavity"):
        mesh = mesh_cad(path, size=SIZE, length_unit="mm", order=1)
    assert volumes(mesh).sum() == pytest.approx(box(30, 20, 20) - box(10, 10, 10))


def test_all_turned_inside_out(tmp_path):
    """With its cavity: what lies outside is told by what encloses what."""
    boxes = box_triangles(*OUTER, outwards=False), box_triangles(*INNER)
    surface, notes = turned_outwards(read_stl(write_boxes(tmp_path / "b.stl", *boxes)))
    assert surface.volume == pytest.approx(30 * 20 * 20 - 10**3)
    (note,) = notes
    assert says(note, "24 of 24 triangles")


def test_a_body_within_a_cavity_is_turned_outwards(tmp_path):
    boxes = [box_triangles(*OUTER), box_triangles(*INNER, outwards=False)]
    boxes.append(box_triangles(*ISLAND))
    path = write_boxes(tmp_path / "b.stl", *boxes, flipped=range(24, 36))
    surface, notes = turned_outwards(read_stl(path))
    assert surface.volume == pytest.approx(30 * 20 * 20 - 10**3 + 4**3)
    assert says(notes[0], "12 of 36 triangles")


def test_an_open_surface_is_turned_as_most_of_it(tmp_path):
    """No volume tells its outside: fTetWild fills it, which goes by the triangles."""
    points, triangles = box_triangles(*OUTER)
    path = write_boxes(tmp_path / "b.stl", (points, triangles[1:]), flipped=[0, 1])
    surface, notes = turned_outwards(read_stl(path))
    assert says(notes[0], "2 of 11 triangles")
    again, silent = turned_outwards(surface)
    np.testing.assert_array_equal(again.triangles, surface.triangles)
    assert silent == []


def test_a_moebius_strip_has_no_inside(tmp_path):
    t = np.linspace(0.0, 2.0 * np.pi, 13)[:-1]
    rim = lambda s: np.stack(
        [
            (10.0 + s * np.cos(t / 2)) * np.cos(t),
            (10.0 + s * np.cos(t / 2)) * np.sin(t),
            s * np.sin(t / 2),
        ],
        axis=1,
    )
    points = np.concatenate([rim(-2.0), rim(2.0)])
    i = np.arange(12)
    a, c = i, i + 12
    b, d = np.roll(i, -1), np.roll(i, -1) + 12
    b[-1], d[-1] = 12, 0  # the ends meet turned over
    triangles = np.concatenate([np.stack(k, axis=1) for k in ((a, b, c), (b, d, c))])
    meshio.Mesh(points, [("triangle", triangles)]).write(tmp_path / "strip.stl")
    with pytest.raises(ValueError, match=r"strip\.stl: .*no inside.*STEP"):
        mesh_cad(tmp_path / "strip.stl", size=SIZE, length_unit="mm")


ARM = (24.0, 5.0, 5.0), (40.0, 15.0, 15.0)
ROD = (10.0, 5.0, 5.0), (20.0, 15.0, 30.0)


@pytest.mark.parametrize("other", [ARM, ROD, ((10.0, 5.0, 0.0), (20.0, 15.0, 15.0))])
@pytest.mark.parametrize("shift", [0, 5])
def test_what_crosses_a_body_is_no_cavity_of_it(tmp_path, other, shift):
    """Whichever of its triangles comes first; so with a wall that touches it."""
    points, triangles = box_triangles(*other)
    boxes = box_triangles(*OUTER), (points, np.roll(triangles, shift, axis=0))
    surface, notes = turned_outwards(read_stl(write_boxes(tmp_path / "b.stl", *boxes)))
    sides = np.subtract(*other[::-1])
    assert surface.volume == pytest.approx(30 * 20 * 20 + np.prod(sides))
    assert notes == []


@pytest.mark.parametrize("header", [b"box", b"solid box"])
def test_a_binary_file_ends_where_it_says(tmp_path, header):
    """Whatever its header begins with, and other programs append."""
    points, triangles = box_triangles(*OUTER)
    facets = np.zeros((12, 50), np.uint8)
    facets[:, 12:48] = points[triangles].astype("<f4").reshape(12, 9).view(np.uint8)
    path = tmp_path / "box.stl"
    head = header.ljust(80) + np.uint32(12).tobytes()
    path.write_bytes(head + facets.tobytes() + b"//+\nMesh.SurfaceFaces = 1;\n" * 9)
    surface = read_stl(path)
    assert len(surface.triangles) == 12
    assert surface.volume == pytest.approx(30 * 20 * 20)
    path.write_bytes(head + facets.tobytes()[:-1])
    with pytest.raises(ValueError, match="0 triangles"):
        read_stl(path)


def test_what_no_program_fills_is_refused_at_once(tmp_path):
    points, triangles = box_triangles(*OUTER)
    path, rng = tmp_path / "bad.stl", np.random.default_rng(0)
    thin = points * np.array([1.0, 1.0, 1e-9])
    one_far = points + 1e15 * (np.arange(8) == 0)[:, None]
    loose = rng.random((36, 3)), np.arange(36).reshape(12, 3)
    for surface, message in (
        ((points + 1e15, triangles), "from the origin"),
        ((one_far, triangles), "thinner"),
        ((thin, triangles), "thinner"),
        (loose, "100% of its edges"),
    ):
        with pytest.raises(ValueError, match=message):
            read_stl(write_boxes(path, surface))


def test_noise_is_refused_at_once(tmp_path):
    """Closed, but with corners at random places."""
    points, triangles = box_triangles(*OUTER)
    noise = np.random.default_rng(0).random(points.shape) * np.ptp(points, axis=0)
    path = write_boxes(tmp_path / "noise.stl", (noise, triangles))
    with pytest.raises(ValueError, match=r"noise\.stl: .* run through others"):
        mesh_cad(path, size=SIZE, length_unit="mm")


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


def deviation(message):
    """The deviation that a message of fTetWild states [m]."""
    (value,) = re.findall(r"lies up to (\S+) mm from", message)
    return float(value) * MM


def test_one_mesh_of_ftetwild_for_a_file_and_its_settings(tmp_path, monkeypatch):
    """And how far it is off, over the hole too: against points spread on the file."""
    pytest.importorskip("pytetwild")
    points, triangles = box_triangles((0, 0, 0), (30, 10, 10))
    path = write_boxes(tmp_path / "box.stl", (points, triangles[1:]))
    make = lambda size=10 * MM, kept_in=tmp_path: mesh_cad(
        path, size=size, length_unit="mm", order=1, kept_in=kept_in
    )
    with pytest.warns(MeshWarning, match="So fTetWild filled it") as said:
        mesh = make()
    (kept,) = tmp_path.glob("box.ftetwild-*.msh")
    u = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 101)] * 2), -1).reshape(-1, 2)
    u = u[u.sum(axis=1) <= 1.0]
    a, b, c = np.moveaxis(points[triangles[1:]], 1, 0)
    spread = a[:, None] + u[:, :1] * (b - a)[:, None] + u[:, 1:] * (c - a)[:, None]
    faces = mesh.points[boundary_faces(mesh)]
    places = np.concatenate([faces.mean(axis=1), faces.reshape(-1, 3)])
    expected = KDTree(MM * spread.reshape(-1, 3)).query(places)[0].max()
    assert deviation(str(said[0].message)) == pytest.approx(expected, rel=0.01)
    with pytest.warns(MeshWarning) as again:
        same = make()
    assert str(again[0].message) == str(said[0].message)
    np.testing.assert_array_equal(same.points, mesh.points)
    np.testing.assert_array_equal(same.tets, mesh.tets)
    # Tets that are left apart go. A folder that cannot be written; and other sizes, for
    # which another one is made.
    far = mesh.points[mesh.tets[0]] + 1.0
    more = np.concatenate([mesh.points, far]), len(mesh.points) + np.arange(4)[None]
    filled = _mesh.Filled(more[0] / MM, np.concatenate([mesh.tets, more[1]]))
    monkeypatch.setattr(_mesh, "fill", lambda *_: filled)
    with pytest.warns(MeshWarning) as said:
        assert make(kept_in=tmp_path / "absent").n_tets == mesh.n_tets
    assert says(str(said[0].message), "another mesh each time ... softcal mesh")
    assert [*tmp_path.glob("*.msh")] == [kept]
    with pytest.warns(MeshWarning):
        make(size=9 * MM)
    assert len([*tmp_path.glob("box.ftetwild-*.msh")]) == 2
    kept.write_text("nothing\n")
    with pytest.raises(ValueError, match=rf"{kept.name}"):
        make()
