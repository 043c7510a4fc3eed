"""What results show of rigid bodies, actuators and their effectors."""

import csv
import dataclasses
import io
import json
import re

import meshio
import numpy as np
import pytest
from cable_project import E_TRUE, FOLDER
from export.handmade import make_fit, make_result, small_model
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from rich.console import Console
from robot_project import write_robot_project
from scipy.spatial.transform import Rotation
from wording import says

from softcal_jax._units import readable_values
from softcal_jax.actuators import actuator_geometry
from softcal_jax.cli import main
from softcal_jax.configurations import EffectorRecord
from softcal_jax.equilibrium import (
    ActuatorState,
    BodyPlace,
    Reaction,
    RobotState,
)
from softcal_jax.plotting import rendering_problem
from softcal_jax.plotting._figure import CABLE, FORCE, MOTOR, WALL
from softcal_jax.project import load_project
from softcal_jax.results import console as drawn, result_dict, sections, write_csv
from softcal_jax.results._calibration import course_charts
from softcal_jax.results._poses import csv_tables

WEIGHT = (60e-3 * 20e-3 * 20e-3 * 1000.0 + 0.01) * 9.81

needs_opengl = pytest.mark.skipif(
    rendering_problem() is not None, reason=str(rendering_problem())
)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """The project, the folder that `softcal simulate` wrote, and what it printed."""
    folder = tmp_path_factory.mktemp("robot")
    path = write_robot_project(folder)
    with pytest.MonkeyPatch.context() as patch:
        printed = io.StringIO()
        patch.setattr("sys.stdout", printed)
        patch.setenv("COLUMNS", "100")
        assert main(["simulate", str(path), "-o", str(folder / "out")]) == 1
    return load_project(path), folder / "out", printed.getvalue()


@pytest.fixture(scope="module")
def entries(robot):
    data = json.loads((robot[1] / "simulation.json").read_text())
    return {entry["name"]: entry for entry in data["configurations"]}


def by_name(parts):
    return {part["name"]: part for part in parts}


def test_forces_and_displacements_of_actuators(entries):
    up = by_name(entries["up"]["robot"]["actuators"])
    assert up["arm"]["imposed"] == "displacement"
    assert up["arm"]["displacement"] == pytest.approx(np.deg2rad(20.0))
    assert (up["left"]["imposed"], up["left"]["force"]) == ("force", 0.3)
    assert up["blow"]["displacement"] is None
    # The torque is also an effector, computed on another way.
    (torque,) = [e for e in entries["up"]["effectors"] if e["name"] == "torque"]
    assert torque["simulated"] == [pytest.approx(up["arm"]["force"], rel=1e-9)]
    gone = by_name(entries["let go"]["robot"]["actuators"])
    assert gone["arm"]["force"] == 0.01
    # The arm has turned so far that the cable is shorter than it was wound up.
    assert gone["left"]["force"] == 0.0
    assert gone["left"]["displacement"] > 1e-3


def test_the_ground_carries_weight_and_forces(entries):
    """The free body of the whole robot; its cable is slack."""
    (arm,) = entries["let go"]["robot"]["reactions"]
    assert arm["name"] == "arm"
    # The equilibrium is left at 1e-8 of the largest force.
    np.testing.assert_allclose(arm["force"], [0, 0, WEIGHT + 0.05], atol=1e-7)


def test_places_of_rigid_bodies(entries):
    arm, tip = entries["up"]["robot"]["rigid_bodies"]
    assert (arm["state"], tip["state"]) == ("held", "free")
    assert entries["let go"]["robot"]["rigid_bodies"][0]["state"] == "hinged"
    np.testing.assert_allclose(
        arm["rotation_vector"], [0, -np.deg2rad(20.0), 0], atol=1e-9
    )
    np.testing.assert_allclose(arm["position_mm"], [-5, 10, 10], atol=1e-9)
    # A 6-D sensor on the tip shows the same.
    sensor, turn = entries["up"]["markers"][0], entries["up"]["effectors"][0]
    np.testing.assert_allclose(sensor["at_rest_mm"], [60, 10, 10], atol=1e-9)
    np.testing.assert_allclose(sensor["simulated_mm"], tip["position_mm"], atol=1e-9)
    assert turn["is_turn"]
    np.testing.assert_allclose(turn["simulated"], tip["rotation_vector"], atol=1e-9)


def test_without_an_equilibrium_nothing_is_shown(entries, robot):
    crushed = entries["crushed"]
    assert crushed["robot"] is None
    assert crushed["files"] == []
    assert [e["simulated"] for e in crushed["effectors"]] == [None, None]
    assert not [p for p in robot[1].iterdir() if "crushed" in p.name]


def test_the_terminal_shows_them(robot):
    text = robot[2]
    for title in ("Other effectors", "Actuators", "Rigid bodies", "Reactions"):
        assert f"\n{title}" in text
    assert "20 deg (imposed)" in text
    assert "300 mN (imposed)" in text
    assert f"(0, 0, {1e3 * (WEIGHT + 0.05):.1f}) mN" in text


def test_robot_csv(robot):
    with (robot[1] / "robot.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["configuration"] for row in rows} == {"up", "let go"}
    (angle,) = [
        row
        for row in rows
        if (row["configuration"], row["name"]) == ("up", "arm")
        and row["quantity"] == "displacement (imposed)"
    ]
    assert (angle["part"], angle["what"], angle["unit"]) == ("actuator", "motor", "rad")
    assert float(angle["value"]) == pytest.approx(np.deg2rad(20.0))
    held = [r for r in rows if r["part"] == "reaction" and r["quantity"] == "force_z"]
    assert float(held[1]["value"]) == pytest.approx(WEIGHT + 0.05, rel=1e-6)


def test_robot_vtu(robot):
    """Cable, forces, faces and frames, at rest and moved."""
    mesh = meshio.read(robot[1] / "up_robot.vtu")
    assert [block.type for block in mesh.cells] == ["vertex", "line", "triangle"]
    vertices, lines, faces = (block.data for block in mesh.cells)
    # Two bodies; motor, point force, surface force. One segment; a side of 3 x 1 cells.
    assert (len(vertices), len(lines), len(faces)) == (5, 1, 6)
    moved = mesh.points + mesh.point_data["displacement"]
    np.testing.assert_allclose(mesh.points[lines[0, 0]], [0, 0.01, 0.03])
    np.testing.assert_allclose(moved[lines[0, 0]], [0, 0.01, 0.03])
    actuator, force = mesh.cell_data["actuator"], mesh.cell_data["lambda_a"]
    assert (actuator[1].item(), force[1].item()) == (2.0, 0.3)
    np.testing.assert_array_equal(force[2], 300.0)
    np.testing.assert_array_equal(mesh.cell_data["rigid_body"][0], [1, 2, 0, 0, 0])
    # The arm turns about -y; its third axis is the hinge, its second one turns.
    np.testing.assert_allclose(mesh.point_data["axis_3"][0], [0, -1, 0], atol=1e-9)
    first = mesh.point_data["axis_1"][0]
    rest = robot[0].model.mechanism.bodies.axes[0, 0]
    turned = Rotation.from_rotvec([0, -np.deg2rad(20.0), 0]).apply(rest)
    np.testing.assert_allclose(first, turned, atol=1e-9)
    body = meshio.read(robot[1] / "up.vtu").point_data["rigid_body"]
    assert sorted(set(body)) == [0.0, 1.0, 2.0]


@needs_opengl
def test_the_picture_shows_what_acts(robot):
    """Forces, and pressures, only where they are not zero."""

    def pixels(name, colour):
        image = imread(robot[1] / f"{name}.png")[130:-130, :, :3]
        return np.sum(np.abs(image - to_rgb(colour)).max(axis=2) < 0.02)

    for colour in (CABLE, MOTOR):
        assert pixels("up", colour) > 100
        assert pixels("let_go", colour) > 100
    assert pixels("up", FORCE) > 100
    legend = lambda name: imread(robot[1] / f"{name}.png")[-130:, :, :3]
    pale = 0.5 * np.array(to_rgb(WALL)) + 0.5
    shows_wall = lambda name: (np.abs(legend(name) - pale).max(axis=2) < 0.02).any()
    assert shows_wall("up")
    assert not shows_wall("let_go")


def test_the_geometry_follows_the_displacement(robot):
    """At rest, where the file has it; a rigid motion takes all along but the ground."""
    mechanism = robot[0].model.mechanism
    rest = actuator_geometry(mechanism.actuators, np.asarray(mechanism.points))
    mm = 1e3 * rest.points
    np.testing.assert_allclose(
        mm, [[-5, 10, 10], [50, 10, 20], [60, 10, 10]], atol=1e-9
    )
    arrows = [[0, -1, 0], [0, 0, -1], [0, 0, 1]]
    np.testing.assert_allclose(rest.arrows, arrows, atol=1e-12)
    up = np.array([0, 0, 0.01])
    shifted = actuator_geometry(mechanism.actuators, mechanism.points + up)
    np.testing.assert_allclose(shifted.points - rest.points, [[0, 0, 0.01]] * 3)
    np.testing.assert_allclose(
        shifted.segments - rest.segments, [[[0, 0, 0], [0, 0, 0.01]]], atol=1e-15
    )


def record(name, quantity, unit, *, measured, before, after):
    """An effector that is no point."""
    measured, before, after = (np.array(v, float) for v in (measured, before, after))
    return EffectorRecord(
        name=name,
        quantity=quantity,
        unit=unit,
        index=0,
        measured=measured,
        std=np.ones_like(measured),
        reference=np.eye(3),
        at_rest=np.full_like(measured, np.nan),
        simulated_before=before,
        simulated=after,
    )


def fit_with_robot():
    """A handmade fit with an orientation, a length, a body and a cable."""
    fit = make_fit(small_model().mesh)
    turn = record(
        "left", "turn", "rad", measured=3 * [0.0], before=[0, 0, 0.2], after=[0, 0, 0.1]
    )
    length = record(
        "length", "scalar", "m", measured=[2e-3], before=[5e-3], after=[3e-3]
    )
    state = RobotState(
        (BodyPlace("plate", "free", np.ones(3), np.zeros(3), np.zeros(3)),),
        (ActuatorState("cable", "cable", "force", 1.5, "N", 2e-3, "m"),),
        (Reaction("x_min", np.array([-1.5, 0.0, 1e-12])),),
        (),
        np.zeros((4, 3)),
    )
    effectors = (*fit.points, turn, length)
    return dataclasses.replace(fit, effectors=effectors, robot=state)


def test_a_calibration_shows_them():
    """Angles in a table of their own; lengths measured, before and after."""
    console = Console(width=100, file=io.StringIO())
    console.print(drawn(sections(make_result(fits=[fit_with_robot()]))))
    text = console.file.getvalue()
    assert "Residuals of the orientations" in text
    assert "11.46 deg" in text  # 0.2 rad
    assert "5.73 deg" in text
    (line,) = [line for line in text.splitlines() if " length " in line]
    assert [cell.strip() for cell in line.split("│")[3:6]] == ["2 mm", "5 mm", "3 mm"]
    assert "1.5 N (imposed)" in text
    assert "(-1.5, 0, 0) N" in text


def test_effectors_and_robot_as_csv(tmp_path):
    fits = [fit_with_robot()]
    json.dumps(result_dict(make_result(fits=fits)), allow_nan=False)
    for name, table in csv_tables(fits).items():
        write_csv(tmp_path / name, table)
    with (tmp_path / "effectors.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [r["coordinate"] for r in rows] == ["turn_x", "turn_y", "turn_z", "value"]
    assert rows[2]["simulated_before"] == "0.2"
    assert (rows[3]["measured"], rows[3]["simulated"]) == ("0.002", "0.003")
    with (tmp_path / "robot.csv").open(newline="") as file:
        parts = [row["part"] for row in csv.DictReader(file)]
    assert parts == 9 * ["rigid body"] + 2 * ["actuator"] + 3 * ["reaction"]


def test_a_fit_of_lengths_alone_shows_its_cost():
    """No marker, no distance: neither a table nor a curve of zeros."""
    fit = fit_with_robot()
    fit = dataclasses.replace(fit, effectors=fit.others)
    result = make_result(fits=[fit])
    console = Console(width=100, file=io.StringIO())
    console.print(drawn(sections(result)))
    assert "Rms distance" not in console.file.getvalue()
    assert course_charts(result)[0].title == "cost"


@pytest.mark.parametrize(
    ("values", "unit", "text"),
    [
        ([2.0, 1e-13, -0.5], "N", "(2, 0, -0.5) N"),
        ([0.0], "N", "0 N"),
        ([0.05], "N m", "50 N mm"),
        ([4e-6], "m3", "4 ml"),
        ([3e-8], "m3", "30 mm3"),
        ([np.nan], "m", "unknown"),
        ([2e-3, np.nan, 0.0], "m", "(2, -, 0) mm"),
    ],
)
def test_values_as_a_person_reads_them(values, unit, text):
    assert readable_values(values, unit) == text


@pytest.mark.slow  # a minute, nearly all of it compiling
def test_the_cable_beam_from_its_project_file(tmp_path, capsys):
    """identify, calibrate: E of a beam of another law, within the noise.

    The candidate moves E more by what is held fixed than by noise: it adds nothing.
    """
    path = str(FOLDER / "project.toml")
    assert main(["identify", path]) == 0
    assert says(capsys.readouterr().out, "No candidate")
    assert main(["calibrate", path, "-o", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    words = " ".join(text.split())
    assert re.search(r"Held-out.* wound up: 0\.1\d* mm .* 1 6-D sensor", words)
    data = json.loads((tmp_path / "out" / "result.json").read_text())
    (E,) = data["parameters"]
    # The law and the mesh of the recordings are others: 1 %.
    assert E["value"] == pytest.approx(E_TRUE, rel=0.02)
    wound_up = data["configurations"][2]
    (cable,) = wound_up["robot"]["actuators"]
    assert cable["displacement"] == pytest.approx(5e-3)
    assert 2.0 < cable["force"] < 3.0
    project = load_project(path)
    start, _ = project.simulate()
    # The start is softer, so the same shortening takes less force.
    assert start.configurations[2].robot.actuators[0].force < cable["force"]
