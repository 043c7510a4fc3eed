"""Meshes of STEP models, against the dimensions of what was modelled."""

import signal
import subprocess
import sys

import numpy as np
import pytest
from exchange.cad.cad_models import (
    CAVITY,
    FINGER,
    INLET,
    MIDDLE,
    gmsh,
    modelled,
    write_finger,
)
from wording import says

from softcal_jax._places import LimitError
from softcal_jax.actuators import Chamber, actuator_arrays
from softcal_jax.elements import TET_EDGES
from softcal_jax.exchange.cad import _mesh, mesh_cad
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
INLET_SIDE = (0.0, 2 * MM, 2 * MM)
CORNERS = 8
"""Of the rim of the inlet: not twelve, for edges are at least a quarter of the size."""
HOLE = 0.5 * CORNERS * np.sin(2 * np.pi / CORNERS) * (INLET * MM) ** 2


@pytest.fixture(scope="module")
def step(tmp_path_factory):
    return write_finger(tmp_path_factory.mktemp("cad") / "finger.step")


@pytest.fixture(scope="module")
def mesh(step):
    return mesh_cad(step, size=SIZE)


def box(*sides):
    return np.prod(sides) * MM ** len(sides)


def area(mesh, faces):
    return face_shares(mesh, faces).sum()


def test_volume_and_edges(mesh):
    channel = 0.5 * (FINGER[0] - CAVITY[0]) * MM * HOLE
    expected = box(*FINGER) - box(*CAVITY) - channel
    # The wall of the round inlet is cut in triangles, not in plane strips.
    assert volumes(mesh).sum() == pytest.approx(expected, rel=3e-4)
    edges = np.array(TET_EDGES)
    X = mesh.points[mesh.tets]
    ends = X[:, edges]
    lengths = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
    assert 0.4 * SIZE < lengths.mean() < 1.2 * SIZE
    # Mid nodes lie in the middle of straight edges.
    np.testing.assert_allclose(X[:, 4:], ends.mean(axis=2), rtol=0, atol=1e-15)


def test_faces_of_the_model_are_groups(mesh):
    """Six outside, five and one with a hole of the cavity, and the inlet's wall."""
    names = [f"face {k + 1}" for k in range(13)]
    assert list(mesh.surface_groups) == names
    assert sum(len(f) for f in mesh.surface_groups.values()) == len(
        boundary_faces(mesh)
    )
    tip = select_face(mesh, (FINGER[0] * MM, 5 * MM, 5 * MM))
    assert area(mesh, tip) == pytest.approx(box(*FINGER[1:]), rel=1e-12)
    side = select_face(mesh, INLET_SIDE)
    assert area(mesh, side) == pytest.approx(box(*FINGER[1:]) - HOLE, rel=1e-9)
    wall = select_face(mesh, (5 * MM, (8 + INLET) * MM, 6 * MM))
    around = 2 * np.pi * INLET * 0.5 * (FINGER[0] - CAVITY[0]) * MM**2
    assert area(mesh, wall) == pytest.approx(around, rel=0.04)


def test_the_wall_of_a_cavity_with_an_inlet_is_a_chamber(mesh):
    mesh = mesh.with_surface_group("base", select_face(mesh, INLET_SIDE))
    wall = select_cavity(mesh, MIDDLE, stop_at=["base"])
    mesh = mesh.with_surface_group("chamber", wall)
    chamber = Chamber("air", "chamber", seal=True)
    arrays = actuator_arrays(mesh, mesh.points, [chamber], {})
    (volume,) = np.asarray(arrays.rest)
    length, circle = 0.5 * (FINGER[0] - CAVITY[0]) * MM, np.pi * (INLET * MM) ** 2
    assert length * HOLE < volume - box(*CAVITY) < length * circle
    # What is missing of the box is what the body and the chamber have in common.
    whole = volumes(mesh).sum() + volume
    assert whole == pytest.approx(box(*FINGER), rel=1e-12)


def test_a_closed_cavity(tmp_path):
    mesh = mesh_cad(write_finger(tmp_path / "f.stp", is_open=False), size=SIZE, order=1)
    assert mesh.order == 1
    assert volumes(mesh).sum() == pytest.approx(box(*FINGER) - box(*CAVITY), rel=1e-12)
    mesh = mesh.with_surface_group("chamber", select_cavity(mesh, MIDDLE))
    arrays = actuator_arrays(mesh, mesh.points, [Chamber("air", "chamber")], {})
    np.testing.assert_allclose(arrays.rest, [box(*CAVITY)], rtol=1e-12)


def test_solids_that_touch_share_their_nodes(tmp_path):
    with modelled(tmp_path / "two.step") as shape:
        shape.addBox(0, 0, 0, 10, 10, 10)
        shape.addBox(10, 0, 0, 20, 10, 10)
    mesh = mesh_cad(tmp_path / "two.step", size=SIZE)
    volume = {name: volumes(mesh)[tets].sum() for name, tets in mesh.tet_groups.items()}
    assert volume == {
        "solid 1": pytest.approx(box(10, 10, 10)),
        "solid 2": pytest.approx(box(20, 10, 10)),
    }
    # The eleven faces but the one between them, which bounds nothing.
    assert len(mesh.surface_groups) == 10
    shared = np.intersect1d(*(mesh.tets[name] for name in mesh.tet_groups.values()))
    np.testing.assert_allclose(mesh.points[shared, 0], 10 * MM, rtol=1e-9)


def test_the_file_states_its_unit(step, tmp_path):
    """The same file with metres in place of millimetres is a thousand times larger."""
    text = step.read_text()
    assert text.count("SI_UNIT(.MILLI.,.METRE.)") == 1
    larger = tmp_path / "larger.step"
    larger.write_text(text.replace("SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT($,.METRE.)"))
    mesh = mesh_cad(larger, size=6.0, order=1)
    np.testing.assert_allclose(np.ptp(mesh.points, axis=0), FINGER, rtol=1e-9)


def test_the_same_mesh_each_time(step, mesh):
    again = mesh_cad(step, size=SIZE)
    np.testing.assert_array_equal(again.points, mesh.points)
    np.testing.assert_array_equal(again.tets, mesh.tets)


def test_without_a_size_it_is_a_thirtieth_of_the_diagonal(step):
    expected = np.linalg.norm(FINGER) / 30 * MM
    mesh = mesh_cad(step, order=1)
    same = mesh_cad(step, size=expected, order=1)
    assert abs(mesh.n_tets - same.n_tets) < 0.02 * same.n_tets


def test_too_coarse_for_a_round_model(tmp_path):
    with modelled(tmp_path / "ball.step") as shape:
        shape.addSphere(0, 0, 0, 10)
    with pytest.warns(MeshWarning, match=r"\d\.\d % less volume.*smaller"):
        mesh_cad(tmp_path / "ball.step", size=10 * MM)


def test_a_surface_alone(tmp_path):
    with modelled(tmp_path / "sheet.step") as shape:
        shape.addRectangle(0, 0, 0, 10, 10)
    with pytest.raises(ValueError, match=r"sheet\.step: .*no solid"):
        mesh_cad(tmp_path / "sheet.step", size=SIZE)
    assert not gmsh.isInitialized()


def test_what_is_no_model(tmp_path):
    bad = tmp_path / "bad.step"
    bad.write_text("no STEP file\n")
    with pytest.raises(ValueError, match=r"bad\.step: "):
        mesh_cad(bad, size=SIZE)
    assert not gmsh.isInitialized()
    with pytest.raises(FileNotFoundError, match=r"bat\.step .*'bad\.step'"):
        mesh_cad(tmp_path / "bat.step", size=SIZE)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": 0.0}, r"size .*positive .*\[m\], got 0\.0"),
        ({"size": SIZE, "order": 3}, "order .* 1 .* got 3"),
        ({"size": SIZE, "length_unit": "mm"}, "'mm'.* STEP .*Leave"),
    ],
)
def test_bad_calls(step, options, message):
    with pytest.raises(ValueError, match=message):
        mesh_cad(step, **options)


def test_too_many_tets(step):
    """A slip of the unit ends at once, not after hours."""
    with pytest.raises(LimitError, match=r"edges of 0\.005 .*limit"):
        mesh_cad(step, size=5e-6)


def test_tets_of_a_thin_plate_are_counted_by_its_surface(tmp_path):
    """Its volume alone would be that of 1.8 million regular ones."""
    with modelled(tmp_path / "plate.step") as shape:
        shape.addBox(0, 0, 0, 300, 300, 0.3)
    with pytest.raises(LimitError, match=r"edges of 0\.5 .* 2 499 \d{3} tets"):
        mesh_cad(tmp_path / "plate.step", size=0.5 * MM)


@pytest.mark.parametrize(
    ("size", "words"),
    [(3 * MM, r"e\+\d\d tets, more"), (None, "across: check its unit")],
)
def test_a_model_in_exametres(step, tmp_path, size, words):
    larger = tmp_path / "larger.step"
    larger.write_text(step.read_text().replace(".MILLI.,.METRE.", ".EXA.,.METRE."))
    with pytest.raises(ValueError, match=words):
        mesh_cad(larger, size=size)


@pytest.fixture
def strip(tmp_path):
    """Two bodies of slightly different height: a sliver face is the step in between."""

    def write(step, *, join=True):
        with modelled(tmp_path / "strip.step") as shape:
            shape.addBox(0, 0, 0, 20, 10, 5)
            shape.addBox(20, 0, 0, 20, 10, 5 + step)
            if join:
                shape.fuse([(3, 1)], [(3, 2)])
        return tmp_path / "strip.step"

    return write


@pytest.mark.parametrize(("step", "join"), [(1e-6, True), (1e-4, True), (1e-6, False)])
def test_sliver_faces_are_merged_into_others(strip, step, join):
    mesh = mesh_cad(strip(step, join=join), size=SIZE, order=1)
    volume = box(20, 10, 5) + box(20, 10, 5 + step)
    assert volumes(mesh).sum() == pytest.approx(volume, rel=step)
    X = mesh.points[mesh.tets]
    edges = np.diff(X[:, np.array(TET_EDGES)], axis=2)
    flatness = volumes(mesh) / np.mean(edges**2, axis=(1, 2, 3)) ** 1.5
    assert flatness.min() > 1e-3
    names, n = [*mesh.surface_groups], 8 if join else 11
    assert len(names) == n - 1
    assert names[-1] == f"face {n}"  # the numbers of the model stay
    areas = sum(area(mesh, mesh.faces(name)) for name in names)
    assert areas == pytest.approx(2 * (box(40, 10) + box(40, 5) + box(10, 5)), rel=1e-4)


def test_flat_tets_are_meshed_again_with_a_smaller_size(tmp_path):
    """Nodes on the two long sides of a sliver, of a low roof, are no pairs at first."""
    with modelled(tmp_path / "roof.step") as shape:
        corners = (0, 0), (10, 0), (10, 5), (5, 5 + 3e-6), (0, 5)
        points = [shape.addPoint(50, y, z) for y, z in corners]
        ends = zip(points, points[1:] + points[:1], strict=True)
        loop = shape.addCurveLoop([shape.addLine(*pair) for pair in ends])
        shape.extrude([(2, shape.addPlaneSurface([loop]))], 50, 0, 0)
        shape.addBox(0, 0, 0, 50, 10, 5)
        shape.fuse([(3, 1)], [(3, 2)])
    mesh = mesh_cad(tmp_path / "roof.step", size=4 * MM, order=1)
    assert len(mesh.surface_groups) == 8
    assert volumes(mesh).sum() == pytest.approx(box(100, 10, 5), rel=1e-6)


def test_flat_tets_that_stay_are_left_to_ftetwild(strip, tmp_path, monkeypatch):
    """Faces keep their numbers; of several solids it would make one."""
    pytest.importorskip("pytetwild")
    program = tmp_path / "program.py"
    text = _mesh.PROGRAM.read_text()
    assert "_NARROW = 1e-3" in text
    program.write_text(text.replace("_NARROW = 1e-3", "_NARROW = 0.0"))
    monkeypatch.setattr(_mesh, "PROGRAM", program)
    path = strip(1e-6)
    with pytest.warns(MeshWarning, match=r"tets are flat.* So fTetWild filled it"):
        wild = mesh_cad(path, size=SIZE, order=1)
    monkeypatch.undo()
    mesh = mesh_cad(path, size=SIZE, order=1)
    assert [*wild.surface_groups] == [*mesh.surface_groups]
    for name in mesh.surface_groups:
        expected = area(mesh, mesh.faces(name))
        assert area(wild, wild.faces(name)) == pytest.approx(expected, rel=0.1)


@pytest.fixture
def box_step(tmp_path):
    with modelled(tmp_path / "box.step") as shape:
        shape.addBox(0, 0, 0, 10, 10, 10)
    return tmp_path / "box.step"


@pytest.mark.parametrize("lost", ["VECTOR(", "FACE_BOUND("])
def test_a_damaged_file_does_not_end_the_program(box_step, lost):
    """Gmsh 4.15 ended with a segmentation fault where such a line is missing."""
    lines = box_step.read_text().splitlines()
    lines.remove(next(line for line in lines if lost in line))
    box_step.write_text("\n".join(lines))
    with pytest.raises(ValueError, match=r"box\.step: .*export it again"):
        mesh_cad(box_step, size=SIZE)


@pytest.mark.parametrize(
    ("program", "limit", "words"),
    [
        ("os.abort()", {}, "gmsh ... crashed ... Aborted ... export it again"),
        ("os.kill(os.getpid(), 9)", {}, "gmsh ... memory ... SOFTCAL_MAX_MESHING_MB"),
        ("sys.exit('no\x1b[1m idea')", {}, r"gmsh fails: no\x1b[1m idea"),
        (
            "sys.exit('terminate called: std::bad_alloc')",
            {},
            "gmsh ... memory ... limit of 8000 MB ... SOFTCAL_MAX_MESHING_MB",
        ),
        ("time.sleep(60)", {"S": "0.2"}, "limit of 0.2 s ... SOFTCAL_MAX_MESHING_S"),
    ],
)
def test_how_the_process_ends_is_said(
    box_step, tmp_path, monkeypatch, program, limit, words
):
    other = tmp_path / "other.py"
    other.write_text(f"import os, sys, time\n{program}\n")
    monkeypatch.setattr(_mesh, "PROGRAM", other)
    for unit, value in limit.items():
        monkeypatch.setenv(f"SOFTCAL_MAX_MESHING_{unit}", value)
    with pytest.raises(ValueError, match=r"box\.step: ") as caught:
        mesh_cad(box_step, size=SIZE)
    assert says(str(caught.value), words)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits the memory")
def test_the_memory_is_limited(step, monkeypatch):
    """Gmsh says so, or crashes."""
    monkeypatch.setenv("SOFTCAL_MAX_MESHING_MB", "1")
    with pytest.raises(ValueError, match=r"limit of 1 MB.*SOFTCAL_MAX_MESHING_MB"):
        mesh_cad(step, size=SIZE)


def test_sigterm_stays_with_python(step):
    """Gmsh takes it once per process, so in a new one: calibrations were killed."""
    code = (
        "import signal, sys\n"
        "from softcal_jax.exchange.cad import mesh_cad\n"
        "signal.signal(signal.SIGTERM, signal.default_int_handler)\n"
        f"mesh_cad(sys.argv[1], size={2 * SIZE})\n"
        "try:\n"
        "    signal.raise_signal(signal.SIGTERM)\n"
        "except KeyboardInterrupt:\n"
        "    print('asked to end')\n"
    )
    command = [sys.executable, "-c", code, str(step)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "asked to end\n"


def test_other_extensions(tmp_path):
    with pytest.raises(ValueError, match=r"'\.igs'.* \.step, \.stp"):
        mesh_cad(tmp_path / "f.igs", size=SIZE)


def test_gmsh_leaves_no_trace(step):
    """Neither its handler of Ctrl-C, nor itself; one that runs already stays."""
    before = signal.getsignal(signal.SIGINT)
    gmsh.initialize(interruptible=False)
    gmsh.model.add("mine")
    try:
        mesh_cad(step, size=2 * SIZE)
        assert gmsh.model.getCurrent() == "mine"
    finally:
        gmsh.finalize()
    mesh_cad(step, size=2 * SIZE)
    assert signal.getsignal(signal.SIGINT) is before
    assert not gmsh.isInitialized()


def test_nothing_is_printed(step, capfd):
    mesh_cad(step, size=2 * SIZE)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("place", ["a box.step", "./a box.step", "../C A D/a box.step"])
def test_a_relative_path(tmp_path, monkeypatch, place):
    """Gmsh works in a folder of its own; what it refuses is named as it was typed."""
    (tmp_path / "C A D").mkdir()
    monkeypatch.chdir(tmp_path / "C A D")
    with modelled("a box.step") as shape:
        shape.addBox(0, 0, 0, 20, 10, 10)
    assert volumes(mesh_cad(place, size=0.02)).sum() == pytest.approx(2e-6)
    _mesh.Path(place).write_text("ISO-10303-21;\n")
    with pytest.raises(ValueError, match=rf"^{_mesh.Path(place)}: "):
        mesh_cad(place, size=0.02)
