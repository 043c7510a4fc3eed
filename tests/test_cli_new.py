"""`softcal new`: ready-made robots, and projects for a mesh, with markers or none."""

import tomllib
from ast import literal_eval

import numpy as np
import pytest
from ready_made import BELLOWS_E, FINGER_E, PAD_E, ordered_robot, write_bellows
from recordings import motion, write_recording
from wording import says

from softcal_jax.cli import main
from softcal_jax.configurations import STANDARD_GRAVITY
from softcal_jax.exchange.proposal import propose_project
from softcal_jax.identifiability import assess
from softcal_jax.mesh import TetMesh, beam, face_areas, node_indices, write_mesh
from softcal_jax.project import ProjectWarning, guesses_left, load_project
from softcal_jax.robots import READY_MADE, ready_made_path, simulated_measurements

PLACES = {"tip": (60.0, 10.0, 10.0), "top": (60.0, 10.0, 21.0), "foot": (5.0, 0.0, 5.0)}
"""Where markers are read at rest [mm]; one lies 1 mm above the beam."""

GUESSED = {**PLACES, "top": (60.0, 10.0, 20.0)}
"""The points of the beam nearest to them [mm]."""

MOVED = {"tip": -2.0, "top": -2.0, "foot": 0.0}
"""How far they move along z, with a weight on the tip [mm]."""


def write_rows(path, shift=(0.0, 0.0, 0.0), unit="_mm", scale=1.0, poses=("rest", "a")):
    """A table of markers, moved as a whole by `shift` [mm]."""
    lines = [f"pose,marker,x{unit},y{unit},z{unit},note"]
    for number, pose in enumerate(poses):
        for name, place in PLACES.items():
            x, y, z = (a + b for a, b in zip(place, shift, strict=True))
            at = [scale * v for v in (x, y, z + number * MOVED[name])]
            lines.append(f"{pose},{name},{','.join(map(str, at))},seen")
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def body(tmp_path):
    """A beam of 60 x 20 x 20 mm, as a file in mm."""
    path = tmp_path / "body.msh"
    write_mesh(beam(0.06, 0.02, 0.02, (6, 2, 2)), path, length_unit="mm")
    return path


def new(folder, *options):
    return main(["new", str(folder), *map(str, options)])


def loaded(folder):
    """The project, with the warning that it has guesses."""
    with pytest.warns(ProjectWarning, match="nobody has confirmed"):
        return load_project(folder / "project.toml", solve=False)


def chambers(proposal):
    """Whether each chamber has a rim, by the name of its surface group."""
    return {one.group: one.is_open for one in proposal.actuated if one.group}


# The arm is loaded and looked at in tests/robots/test_pneumatic_arm.py.
SLOW = {"pneumatic-arm": pytest.mark.slow}


@pytest.mark.parametrize(
    "robot", [pytest.param(name, marks=SLOW.get(name, ())) for name in READY_MADE]
)
def test_ready_made_robots_are_complete(tmp_path, capsys, robot):
    """They load without a warning, lack nothing, and say what is made up."""
    if robot == "pneumatic-arm":
        pytest.importorskip("ezc3d")
    folder = tmp_path / "robots" / "mine"
    assert new(folder, "--robot", robot) == 0
    assert f"softcal check {folder / 'project.toml'}" in capsys.readouterr().out
    project = load_project(folder / "project.toml", solve=False)
    project.check_calibration()
    project.check_identify()
    assert project.validation
    assert guesses_left(project.path) == ()
    measured = robot in ("beam", "pneumatic-arm", "tentacle", "emio")
    readme = (folder / "README.md").read_text()
    assert measured != ("**the readings" in readme and "computed" in readme)
    assert main(["check", str(folder / "project.toml"), "--no-pictures"]) == 0
    text = capsys.readouterr().out
    assert "would refuse" not in text
    assert "Guesses" not in text
    # A pose "20 kPa" is the name of a row, where it is selected.
    assert "measured.select.pose" not in text


def test_the_parallel_robot_is_that_of_the_python_api(tmp_path):
    new(tmp_path / "robot", "--robot", "parallel-robot")
    project = load_project(tmp_path / "robot/project.toml", solve=False)
    ordered = ordered_robot()
    # Mid nodes are numbered differently once they were not in the file.
    ours, theirs = (m.mesh.centroids for m in (project.model, ordered.model))
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
    bodies, others = (m.mechanism.bodies for m in (project.model, ordered.model))
    np.testing.assert_allclose(bodies.origin, others.origin, atol=1e-12)
    np.testing.assert_allclose(bodies.axes, others.axes, atol=1e-12)
    np.testing.assert_array_equal(np.bincount(bodies.body), np.bincount(others.body))
    np.testing.assert_allclose(project.model.density, ordered.model.density)
    assert project.space is not None
    assert project.space.names == ordered.space.names
    pairs = zip(project.parameters, ordered.space.parameters, strict=True)
    for ours, theirs in pairs:
        for key in ("start", "lower", "upper", "prior_std"):
            assert getattr(ours, key) == pytest.approx(getattr(theirs, key)), ours.name
    for ours, theirs in zip(
        project.configurations,
        (*ordered.configurations, *ordered.validation),
        strict=True,
    ):
        assert ours.name == theirs.name
        asked = {name: imposed.value for name, imposed in theirs.actuation.items()}
        read = {name: imposed.value for name, imposed in ours.actuation.items()}
        assert read == pytest.approx(asked)


def test_a_mesh_with_markers(tmp_path, body, capsys):
    """What is found is written, what is guessed has a remark, and `check` lists it."""
    table, folder = write_rows(tmp_path / "poses.csv"), tmp_path / "mine"
    assert new(folder, "--model", body, "--markers", table) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert says(text, "(60, 20, 20) mm, ... mm")
    assert says(text, "Poses: rest ... a")
    assert "tip: inside top: 1 mm foot: inside" in text
    assert {p.name for p in folder.iterdir()} == {
        "body.msh",
        "poses.csv",
        "project.toml",
    }
    project = loaded(folder)
    project.check_calibration()
    rest, pose = project.calibration
    assert (rest.name, pose.name) == ("rest", "a")
    assert rest.loads == ()
    np.testing.assert_allclose(1e3 * pose.markers.positions, [*GUESSED.values()])
    np.testing.assert_allclose(
        1e3 * (pose.measured - rest.measured)[:, 2], [*MOVED.values()]
    )
    assert pose.displacement_from == "rest"
    # The markers that move are at the other end; the weight of the body hangs there.
    (support,) = pose.supports
    held = node_indices(project.model.mesh, support.where, "a support")
    np.testing.assert_allclose(project.model.mesh.points[held][:, 0], 0.0, atol=1e-9)
    (load,) = pose.loads
    # The centroid of the first tet of those that meet at the tip.
    assert load.point == pytest.approx((0.0575, 0.0075, 0.005))
    assert load.force == pytest.approx((0.0, 0.0, -0.3))

    assert main(["check", str(folder / "project.toml"), "--no-pictures"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    listed = text[text.index("Guesses") :]
    listed = listed[: listed.index("Model")]
    for guess in (
        'length_unit = "mm" a guess ... (60, 20, 20) mm',
        "[groups.held] ... farther from the markers",
        'E = "200 kPa" the start',
        'name = "rest" ... gravity',
        'force = "(0, 0, -0.3) N" }]',
    ):
        assert says(listed, guess)
    # A confirmed guess is none any more.
    path = folder / "project.toml"
    before = len(guesses_left(path))
    path.write_text(path.read_text().replace(" # CHANGE: how well a pose repeats", ""))
    assert len(guesses_left(path)) == before - 1


def test_a_mesh_alone_can_be_judged_and_not_calibrated(tmp_path, body, capsys):
    assert new(tmp_path / "mine", "--model", body, "--length-unit", "mm") == 0
    text = capsys.readouterr().out
    assert "There are no readings yet" in text
    assert "softcal calibrate " not in text.split("Next:")[1]
    project = loaded(tmp_path / "mine")
    project.check_identify()
    project.check_simulation()
    with pytest.raises(ValueError, match="no `measured` positions"):
        project.check_calibration()
    assert not any("unit" in guess.remark for guess in guesses_left(project.path))
    # Where they can be glued: on the end, and on the top of the beam.
    markers = project.configurations[0].markers
    assert dict(zip(markers.names, 1e3 * markers.positions, strict=True)) == {
        "tip": pytest.approx([60.0, 10.0, 10.0]),
        "middle": pytest.approx([30.0, 10.0, 20.0]),
    }


def test_groups_are_known_by_their_names(tmp_path):
    """A clamp, and a chamber that is the wall of a cavity."""
    arm = ready_made_path("pneumatic-arm").with_name("arm.msh")
    table = write_rows(tmp_path / "poses.csv", poses=("0 kPa", "12 kPa"))
    proposal = propose_project(arm, tmp_path / "mine", recordings=[table])
    assert proposal.held.group == "clamp"
    assert chambers(proposal) == {"chamber": False}
    project = loaded(tmp_path / "mine")
    (support,) = project.calibration[0].supports
    assert support.where == "clamp"
    assert project.calibration[0].actuation == {}
    assert "seal" not in (tmp_path / "mine/project.toml").read_text()
    (asked,) = project.calibration[1].actuation.values()
    assert asked.value == pytest.approx(12e3)


@pytest.mark.parametrize(("moves", "held"), [(0.06, 0.0), (0.0, 0.06)])
def test_the_end_away_from_what_moves_is_held(tmp_path, body, moves, held):
    rows = ["pose,marker,x_mm,y_mm,z_mm"]
    rows += [f"{pose},m,{1e3 * moves},10,{z}" for pose, z in (("rest", 10), ("a", 8))]
    (tmp_path / "poses.csv").write_text("\n".join(rows))
    propose_project(body, tmp_path / "mine", recordings=[tmp_path / "poses.csv"])
    project = loaded(tmp_path / "mine")
    mesh, (support,) = project.model.mesh, project.calibration[0].supports
    nodes = node_indices(mesh, support.where, "a support")
    np.testing.assert_allclose(mesh.points[nodes][:, 0], held, atol=1e-9)


def test_a_chamber_by_its_name_alone_is_none(tmp_path):
    made = beam(0.06, 0.02, 0.02, (6, 2, 2))
    made = made.with_surface_group("air chamber", made.surface_groups["z_max"])
    write_mesh(made, tmp_path / "body.msh", length_unit="mm")
    proposal = propose_project(tmp_path / "body.msh", tmp_path / "mine")
    assert chambers(proposal) == {}


def test_a_recording_in_a_frame_of_its_own_is_not_used_as_it_is(tmp_path, body, capsys):
    """Until the file says where its markers are; then the frames are registered."""
    shift = (400.0, 0.0, 900.0)
    table, folder = write_rows(tmp_path / "poses.csv", shift), tmp_path / "mine"
    assert new(folder, "--model", body, "--markers", table) == 0
    assert says(capsys.readouterr().out, "its own frame")
    with pytest.raises(ValueError, match="no `measured` positions"):
        loaded(folder).check_calibration()
    path = folder / "project.toml"
    lines = path.read_text().splitlines()
    keys = (
        "[shared.measured]",
        "file",
        "displacement",
        "registration",
        "measured.select",
    )
    for i, line in enumerate(lines):
        if line.startswith(tuple(f"# {key}" for key in keys)):
            lines[i] = line[2:]
        for name, place in PLACES.items():
            if line.startswith(f"{name} = "):
                lines[i] = f'{name} = "({", ".join(map(str, place))}) mm"'
    path.write_text("\n".join(lines))
    project = loaded(folder)
    project.check_calibration()
    assert {"rest", "a"} == project.registrations.keys()
    np.testing.assert_allclose(
        1e3 * project.registrations["rest"].translation, np.negative(shift), atol=1e-9
    )


def test_units_are_guessed_by_size(tmp_path):
    """A mesh in metres, and columns that carry no unit."""
    made = beam(0.06, 0.02, 0.02, (6, 2, 2))
    write_mesh(made, tmp_path / "body.msh", length_unit="m")
    table = write_rows(tmp_path / "poses.csv", unit="", scale=0.1)
    proposal = propose_project(
        tmp_path / "body.msh", tmp_path / "mine", recordings=[table]
    )
    assert proposal.body.unit == "m"
    assert proposal.recorded.unit == "cm"
    project = loaded(tmp_path / "mine")
    np.testing.assert_allclose(project.model.mesh.size, made.size)
    np.testing.assert_allclose(
        1e3 * project.calibration[0].markers.positions, [*GUESSED.values()]
    )


def test_places_of_markers_are_guesses(tmp_path, body, capsys):
    """Read at rest, where the body hangs 7 mm down; whatever the pose is called."""
    table = write_rows(tmp_path / "poses.csv", (0, 0, -7.0), poses=("unloaded", "a"))
    assert new(tmp_path / "mine", "--model", body, "--markers", table) == 0
    assert says(capsys.readouterr().out, "Missing: where the markers are glued")
    project = loaded(tmp_path / "mine")
    placed = project.calibration[0].markers.positions
    np.testing.assert_allclose(1e3 * placed[:, 2], [3.0, 14.0, 0.0], atol=1e-9)
    guesses = {g.text.split()[0]: g.remark for g in guesses_left(project.path)}
    assert says(guesses["foot"], "glued ... 2 mm from the mesh")
    assert {"tip", "top", "foot"} <= guesses.keys()


def test_recordings_over_time_hold_a_pose_each(tmp_path, body):
    pytest.importorskip("ezc3d")
    for name, factor in (("10 N", 1.0), ("20 N", 2.0)):
        path = motion()
        path[:, 1, 2] *= -1.0  # down, as a weight moves it
        path[:, 1] = path[:, 1] * 0.2 * factor + 10.0
        write_recording(tmp_path / f"{name}.c3d", path)
    files = [tmp_path / "10 N.c3d", tmp_path / "20 N.c3d"]
    made = propose_project(body, tmp_path / "mine", recordings=files)
    recorded = made.recorded
    assert [pose.name for pose in made.poses] == ["rest", "10 N", "20 N"]
    assert recorded.stillest(1) == ["base"]
    project = loaded(tmp_path / "mine")
    project.check_calibration()
    (held_out,) = project.validation
    assert held_out.name == "20 N"
    # It moves by 1.2 mm in each of 20 frames, of which the last eleven are averaged.
    moved = held_out.measured - project.calibration[0].measured
    np.testing.assert_allclose(1e3 * moved[:, 2], [0.0, -1.2 * 15.0], atol=1e-5)


def test_rows_are_told_apart_by_the_fewest_columns(tmp_path, body):
    """The pose, not a note that all share; two columns where one does not do."""
    lines = ["run,phase,marker,x_mm,y_mm,z_mm"]
    for run in ("1", "2"):
        for phase in ("rest", "loaded"):
            lines.append(f"{run},{phase},tip,60,10,{10 if phase == 'rest' else 9}")
    (tmp_path / "poses.csv").write_text("\n".join(lines))
    made = propose_project(body, tmp_path / "mine", recordings=[tmp_path / "poses.csv"])
    names = ["1 rest", "1 loaded", "2 rest", "2 loaded"]
    assert [pose.name for pose in made.poses] == names
    assert made.poses[1].select == '{ run = "1", phase = "loaded" }'


def test_a_cad_model(tmp_path):
    models = pytest.importorskip("exchange.cad.cad_models")
    step = models.write_finger(tmp_path / "finger.step")
    assert new(tmp_path / "mine", "--model", step, "--size", "5 mm") == 0
    project = loaded(tmp_path / "mine")
    assert "face 13" in (tmp_path / "mine/project.toml").read_text()
    (support,) = project.calibration[0].supports
    held = node_indices(project.model.mesh, support.where, "a support")
    np.testing.assert_allclose(project.model.mesh.points[held][:, 0], 0.0, atol=1e-9)


def test_cavities_and_long_holes_of_a_cad_model_are_actuated(tmp_path, capsys):
    """An open chamber and a tendon, each driven by its column; a screw hole is none."""
    models = pytest.importorskip("exchange.cad.cad_models")
    with models.modelled(tmp_path / "finger.step") as shape:
        shape.addBox(0, 0, 0, 60, 15, 15)
        parts = (
            shape.addBox(-1, 4, 8, 55, 7, 4),
            shape.addCylinder(-1, 7, 3, 62, 0, 0, 1),
        )
        screw = shape.addCylinder(57, 3, -1, 0, 0, 6, 1.5)
        shape.cut([(3, 1)], [(3, part) for part in (*parts, screw)])
    table = tmp_path / "poses.csv"
    rows = ["pose,air (kPa),tension_N,marker,x_mm,y_mm,z_mm"]
    for pose, acting, z in (("a", "0,0", 7), ("b", "12.5,0", 5), ("c", "0,0.5", 9)):
        rows.append(f"{pose},{acting},tip,60,10,{z}")
    table.write_text("\n".join(rows))
    options = "--model", tmp_path / "finger.step", "--size", "5 mm", "--markers", table
    assert new(tmp_path / "mine", *options) == 0
    text = capsys.readouterr().out
    assert says(
        text, "Chamber: air, an open cavity (faces", "Cable: cable, a long round"
    )
    project = loaded(tmp_path / "mine")
    imposed = [
        {name: asked.value for name, asked in c.actuation.items()}
        for c in project.configurations
    ]
    assert imposed == [{}, {"air": 12.5e3, "cable": 0.0}, {"air": 0.0, "cable": 0.5}]
    assert not any(c.loads for c in project.configurations)
    air, cable = project.model.mechanism.actuators.names
    assert (air, cable) == ("air", "cable")
    remarks = {g.text.split(" = ")[0]: g.remark for g in guesses_left(project.path)}
    assert says(remarks["guides"], "axis", "face ")
    assert says(remarks["[groups.air_wall]"], "open cavity (faces")
    assert says(remarks["[groups.air_opening]"], "opens (face 1)")
    assert says(remarks["surface"], "open cavity (faces")
    actuators = tomllib.loads(project.path.read_text())["actuators"]
    guides = [literal_eval(g.removesuffix(" mm")) for g in actuators["cable"]["guides"]]
    x, *across = np.transpose(guides)
    np.testing.assert_allclose(across, np.repeat([[7.0], [3.0]], len(x), 1), atol=0.01)
    np.testing.assert_allclose(sorted(x)[:: len(x) - 1], [1.0, 59.0], atol=0.05)


@pytest.mark.parametrize("is_open", [False, True])
def test_a_cavity_of_a_mesh_is_inflated_by_what_poses_are_called(tmp_path, is_open):
    whole = beam(0.06, 0.02, 0.02, (12, 4, 4))
    off = np.abs(whole.centroids - [0.03, 0.01, 0.01])
    kept = (off > [0.02, 0.005, 0.005]).any(axis=1)
    if is_open:
        kept &= (whole.centroids[:, 0] > 0.02) | (off[:, 1:] > 0.005).any(axis=1)
    used, tets = np.unique(whole.tets[kept], return_inverse=True)
    hollow = TetMesh(whole.points[used], tets.reshape(-1, 4).astype(np.int32))
    write_mesh(hollow, tmp_path / "body.msh", length_unit="mm")
    table = write_rows(tmp_path / "poses.csv", poses=("no load", "at_15kPa"))
    made = propose_project(tmp_path / "body.msh", tmp_path / "mine", recordings=[table])
    assert chambers(made) == {"air_wall": is_open}
    project = loaded(tmp_path / "mine")
    assert project.configurations[1].actuation["air"].value == pytest.approx(15e3)
    walls = project.model.mesh.surface_groups["air_wall"]
    area = face_areas(project.model.mesh, walls)[0].sum()
    sides = 4 * 0.01 * (0.05 if is_open else 0.04) + (1 if is_open else 2) * 1e-4
    assert area == pytest.approx(sides)


@pytest.mark.parametrize(
    ("stated", "load"),
    [("0,5 N", 0.5), ("mass 50 g", 0.050 * STANDARD_GRAVITY), ("15 kPa", None)],
)
def test_a_force_or_mass_without_a_cable_hangs_on_the_tip(tmp_path, body, stated, load):
    (tmp_path / "poses.csv").write_text(
        f"pose;marker;x_mm;y_mm;z_mm\nrest;tip;60;10;10\n{stated};tip;60;10;8"
    )
    propose_project(body, tmp_path / "mine", recordings=[tmp_path / "poses.csv"])
    (acting,) = loaded(tmp_path / "mine").configurations[1].loads
    text = (tmp_path / "mine/project.toml").read_text()
    assert ("by the column pose" in text) == (load is not None)
    # A pressure has nothing to inflate: the weight of the beam is guessed, as ever.
    down = 0.3 if load is None else load
    assert acting.force == pytest.approx((0.0, 0.0, -down), rel=1e-3)


def test_two_tets_across_the_thinnest_wall_are_proposed(tmp_path):
    """With what they cost; and as for bending where every wall is thick."""
    models = pytest.importorskip("exchange.cad.cad_models")
    with models.modelled(tmp_path / "thin.step") as shape:
        shape.addBox(0, 0, 0, 30, 8, 8)
        shape.cut([(3, 1)], [(3, shape.addBox(3, 2.8, 2.4, 24, 2.4, 2.8))])
    with models.modelled(tmp_path / "thick.step") as shape:
        shape.addBox(0, 0, 0, 30, 8, 8)
    thin, thick = (
        propose_project(tmp_path / f"{name}.step", tmp_path / name).body
        for name in ("thin", "thick")
    )
    assert thin.size == "1.2 mm"
    assert says(thin.why, "wall, 2.4 mm at face", f"{thin.mesh.n_tets} tets")
    assert thick.size == "1.6 mm"
    assert "wall" not in thick.why


def test_nothing_is_overwritten(tmp_path, body, capsys):
    (tmp_path / "mine").mkdir()
    for options in (("--robot", "beam"), ("--model", body)):
        assert new(tmp_path / "mine", *options) == 2
        assert says(capsys.readouterr().err, "there already")
    assert [*(tmp_path / "mine").iterdir()] == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--robot", "cable-baem"], "Did you mean 'cable-beam'?"),
        (["--robot", "beam", "--size", "3 mm"], "--size is for a model"),
        (["--model", "boddy.msh"], "Did you mean 'body.msh'?"),
        (["--model", "body.txt"], "has the extension '.txt'"),
        (["--model", "broken.msh"], "broken.msh"),
        (["--model", "body.msh", "--length-unit", "ft"], "unknown length unit 'ft'"),
        (["--model", "body.msh", "--markers", "other.csv"], "'marker' is missing"),
        (["--model", "body.msh", "--markers", "twice.csv"], "'tip' is there twice"),
        (["--model", "body.msh", "--markers", "a.csv", "other.csv"], "give it alone"),
        (["--model", "finger.step", "--size", "3"], "--size: 3 has no unit"),
    ],
)
def test_what_is_refused_leaves_nothing(
    tmp_path, body, monkeypatch, capsys, options, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "body.txt").write_text("a body")
    (tmp_path / "broken.msh").write_text("$MeshFormat\n2.2 0 8\n")
    (tmp_path / "other.csv").write_text("time,x_mm,y_mm,z_mm\n0,1,2,3\n")
    (tmp_path / "twice.csv").write_text("marker,x_mm,y_mm,z_mm\ntip,1,2,3\ntip,1,2,4\n")
    write_rows(tmp_path / "a.csv")
    before = sorted(tmp_path.iterdir())
    assert new(tmp_path / "mine", *options) == 2
    assert message in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("options", [[], ["--robot", "beam", "--model", "body.msh"]])
def test_a_robot_or_a_model_is_needed(tmp_path, capsys, options):
    with pytest.raises(SystemExit) as stopped:
        new(tmp_path / "mine", *options)
    assert stopped.value.code == 2
    assert says(capsys.readouterr().err, "--robot ... --model")


@pytest.mark.slow  # a minute, nearly all of it compiling
def test_a_proposed_project_is_calibrated_as_it_is(tmp_path, body):
    """With readings of the beam that it guesses, E comes out."""
    new(tmp_path / "first", "--model", body)
    changes = {"material.E": "300 kPa"}
    truth = load_project(tmp_path / "first/project.toml", changes=changes)
    lines = ["pose,marker,x_mm,y_mm,z_mm"]
    for c in simulated_measurements(truth.model, truth.configurations):
        pose = {"hanging": "rest"}.get(c.name, c.name)
        for name, place in zip(c.markers.names, c.measured, strict=True):
            lines.append(f"{pose},{name},{','.join(f'{1e3 * x:.6f}' for x in place)}")
    (tmp_path / "poses.csv").write_text("\n".join(lines))
    new(tmp_path / "mine", "--model", body, "--markers", tmp_path / "poses.csv")
    with pytest.warns(ProjectWarning, match="hold a guess"):
        project = load_project(tmp_path / "mine/project.toml")
    result = project.calibrate()
    assert result.converged
    (E,) = result.parameters
    # The places of the markers are guesses, millimetres from where they are glued.
    assert E.value == pytest.approx(300e3, rel=0.02)


@pytest.mark.slow  # minutes
@pytest.mark.parametrize("robot", ["pneumatic-finger", "parallel-robot"])
def test_ready_made_robots_are_calibrated(tmp_path, robot):
    """The finger to its modulus; and both predict poses not seen before."""
    new(tmp_path / "mine", "--robot", robot)
    result = load_project(tmp_path / "mine/project.toml").calibrate()
    assert result.converged
    if robot == "pneumatic-finger":
        (E,) = result.parameters
        assert abs(E.value - FINGER_E) < 2.0 * E.standard_error
    held_out = [c for c in result.configurations if c.role == "validation"]
    assert held_out
    # Not each pose of seven: the readings have noise.
    before, after = (
        [getattr(c, k) for c in held_out] for k in ("rms_before", "rms_after")
    )
    assert np.mean(after) < 0.7 * np.mean(before)


@pytest.mark.slow  # minutes
def test_the_pressed_pad_is_calibrated(tmp_path):
    """Presses alone tell the moduli of its halves, and each force of the last one."""
    new(tmp_path / "mine", "--robot", "pressed-pad")
    result = load_project(tmp_path / "mine/project.toml").calibrate()
    assert assess(result).outcome == "trust"
    for E, true in zip(result.parameters, PAD_E.values(), strict=True):
        assert abs(E.value - true) < 2.0 * E.standard_error
    (middle,) = [c for c in result.configurations if c.role == "validation"]
    (cell,) = middle.effectors
    assert np.all(np.abs(cell.residual) < 3.0 * cell.std)


def test_the_mesh_of_the_bellows_finger_is_as_it_is_made(tmp_path):
    write_bellows(tmp_path / "bellows.msh")
    committed = ready_made_path("bellows-finger").with_name("bellows.msh")
    assert committed.read_text() == (tmp_path / "bellows.msh").read_text()


@pytest.mark.slow  # minutes
@pytest.mark.parametrize("touching", [True, False])
def test_the_bellows_finger_is_calibrated_where_its_folds_touch(tmp_path, touching):
    """Where they pass through each other the result says so, and E is far too low."""
    new(tmp_path / "mine", "--robot", "bellows-finger")
    changes = {} if touching else {"material.touching": None}
    result = load_project(tmp_path / "mine/project.toml", changes=changes).calibrate()
    (E,) = result.parameters
    if touching:
        assert result.converged
        assert abs(E.value - BELLOWS_E) < 2.0 * E.standard_error
        assert all(c.self_contact is None for c in result.configurations)
        (held_out,) = [c for c in result.configurations if c.role == "validation"]
        assert held_out.rms_after < 0.2 * held_out.rms_before
    else:
        assert E.value < 0.6 * BELLOWS_E
        assert BELLOWS_E - E.value > 10.0 * E.standard_error
        assert "touches itself" in str(assess(result))


@pytest.mark.filterwarnings("ignore::softcal_jax.mesh.MeshWarning")
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_project_of_a_round_model_loads_with_other_sizes(tmp_path, factor):
    """Its load acts within the body: flat faces of other tets are off its round end."""
    cad_models = pytest.importorskip("exchange.cad.cad_models")
    with cad_models.modelled(tmp_path / "finger.step") as shape:
        shape.addCylinder(0, 0, 0, 60, 0, 0, 8)
        shape.addSphere(60, 0, 0, 8)
        shape.fuse([(3, 1)], [(3, 2)])
    propose_project(tmp_path / "finger.step", tmp_path / "mine", size=4e-3)
    changes = {"mesh.size": f"{4 * factor:g} mm"}
    path = tmp_path / "mine" / "project.toml"
    project = load_project(path, changes=changes, solve=False)
    assert project.model.mesh.n_tets > 100
