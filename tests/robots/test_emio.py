"""The packaged robot on four soft legs: body, motors, poses and readings, no fit."""

import csv
import tomllib
from ast import literal_eval

import numpy as np
import pytest

import softcal_jax as sc
from benchmarks import _emio_leg, _emio_mesh, emio
from benchmarks._emio_angles import approach
from benchmarks._emio_robot import MOTORS, pose, robot
from softcal_jax.control import actuator_compliance
from softcal_jax.mesh import TetMesh, to_quadratic, volumes
from softcal_jax.project import load_project
from softcal_jax.robots import ready_made_path

FOLDER = ready_made_path("emio").parent


@pytest.fixture(scope="module")
def project():
    return load_project(FOLDER / "project.toml", solve=False)


@pytest.fixture(scope="module")
def tables():
    return tomllib.loads((FOLDER / "project.toml").read_text())


def millimetres(text):
    return np.array(literal_eval(text.removesuffix(" mm")), float)


def test_files():
    source = " ".join((FOLDER / "README.md").read_text().split())
    assert "SofaComplianceRobotics/Emio.validation" in source
    assert "SofaComplianceRobotics/Emio.CoreAssets" in source
    assert "MIT licence" in source
    assert "Compliance Robotics" in (FOLDER / "LICENSE-recordings.txt").read_text()


def test_readings():
    """One row of the source's table, typed by hand."""
    row = emio.poses()[1]
    assert [float(row[f"{a}_mm"]) for a in "xyz"] == [17.08, -100.5, -10.54]
    assert [float(row[f"target_{a}_mm"]) for a in "xyz"] == [16.0, -98.0, -8.0]
    assert float(row["scene_x_mm"]) == pytest.approx(15.9410917, abs=1e-4)
    assert len(emio.poses()) == 260


def test_poses_have_the_angles_of_the_table(project):
    """Fitted are twelve; those held out here are six of the other 248."""
    fitted, held_out = project.calibration, project.validation
    assert (len(fitted), len(held_out)) == (12, 6)
    rows = {row["pose"]: row for row in emio.poses()}
    for posed in (*fitted, *held_out):
        row = rows[posed.name]
        angles = [float(row[f"{motor.replace(' ', '_')}_deg"]) for motor in MOTORS]
        asked = [posed.actuation[motor].value for motor in MOTORS]
        np.testing.assert_allclose(np.rad2deg(asked), angles, atol=1e-3)
        read = [float(row[f"{axis}_mm"]) for axis in "xyz"]
        np.testing.assert_allclose(1e3 * posed.measured[0], read, atol=1e-9)


def test_poses_of_the_table_are_posed_as_those_of_the_project(project):
    fitted = project.calibration[3]
    (row,) = [row for row in emio.poses() if row["pose"] == fitted.name]
    made = emio.posed(project, row)
    for motor, imposed in fitted.actuation.items():
        assert made.actuation[motor].value == pytest.approx(imposed.value, abs=1e-5)


def test_the_mesh_is_what_its_script_makes(project):
    made = _emio_mesh.emio(_emio_mesh.BUILT, 24)
    corners = 1e3 * project.model.mesh.points[: len(made.points)]
    np.testing.assert_allclose(corners, made.points, atol=1e-9)
    assert len(made.cells_dict["tetra"]) == len(project.model.mesh.tets)


def test_body(project):
    """The volume of four strips, arcs included, and of two blocks."""
    leg = _emio_mesh.BUILT
    length = _emio_mesh.END + 0.5 * np.pi * leg.radius
    expected = 4 * 50.0 * length + 2 * 1e3
    assert 1e9 * np.sum(volumes(project.model.mesh)) == pytest.approx(
        expected, rel=5e-3
    )


@pytest.mark.parametrize("k", range(4))
def test_legs_meet_the_centre_part(tables, k):
    """`mounting` brings a tip into its socket, and turns the leg to point inwards."""
    leg, azimuth = _emio_mesh.BUILT, float(_emio_mesh.AZIMUTHS[k])
    out, up, axis = _emio_mesh.axes(azimuth)
    motor = tables["bodies"][f"motor {k + 1}"]
    np.testing.assert_allclose(millimetres(motor["origin"]), leg.circle * out)
    np.testing.assert_allclose(motor["hinge"], axis)
    tip = tables["bodies"][f"tip {k + 1}"]
    (end,) = _emio_mesh.place(leg, azimuth, np.array([[0.0, leg.clamped, leg.radius]]))
    np.testing.assert_allclose(millimetres(tip["origin"]), end, atol=1e-9)
    moved = end + millimetres(tip["mounting"]["translation"])
    socket = _emio_mesh.HOME + leg.inside * out + leg.above * up
    np.testing.assert_allclose(moved, socket, atol=1e-9)
    turn = literal_eval(tip["mounting"]["rotation_vector"].removesuffix(" deg"))
    np.testing.assert_allclose(np.array(turn), -90.0 * axis, atol=1e-9)
    rotation = sc.Pose((0.0, 0.0, 0.0), np.deg2rad(turn)).matrix
    np.testing.assert_allclose(rotation @ -up, -out, atol=1e-9)


@pytest.mark.slow
def test_angles_bring_the_scene_where_it_was():
    """On a coarse mesh: the motors that `approach` finds do it without idle work."""
    model = robot(_emio_mesh.SCENE, 8, across=(1, 1))
    lane = sc.lanes(model, pose("scene", np.zeros(4)))[0]
    rest = sc.solve_equilibrium(model, lane)
    place = np.array([4.0, -140.0, -3.0])
    found, u = approach(model, lane, (None, np.zeros(4), rest.displacement), place)
    there = sc.lanes(model, pose("there", found.angles))[0]
    solution = sc.solve_equilibrium(model, there, guess=u)
    compliance = actuator_compliance(model, there, solution)
    reached = 1e3 * np.asarray(compliance.state.effectors)[0]
    np.testing.assert_allclose(reached, place, atol=1e-2)
    idle = np.linalg.svd(np.asarray(compliance.W_ea)[:3])[2][-1]
    torques = np.asarray(compliance.state.forces)
    assert abs(idle @ torques) < 1e-3 * np.linalg.norm(torques)


@pytest.mark.slow
def test_linear_tets_lock_and_quadratic_ones_do_not():
    """The clamped leg against the theory of beams, between the authors' boxes."""
    mesh = _emio_leg.authors_mesh()
    linear = _emio_leg.stiffness("linear", mesh)
    quadratic = _emio_leg.stiffness("quadratic", to_quadratic(mesh))
    beam = _emio_leg.beam_across(0.188)
    assert quadratic.across == pytest.approx(beam, rel=0.05)
    assert linear.across > 3.0 * quadratic.across


def test_refined_tets_fill_the_same_body():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    mesh = TetMesh(points, np.array([[0, 1, 2, 3]]))
    fine = _emio_leg.refine(mesh)
    assert len(fine.tets) == 8
    assert (volumes(fine) > 0.0).all()
    np.testing.assert_allclose(volumes(fine).sum(), 1.0 / 6.0)


def test_headers_of_the_table():
    with (FOLDER / "poses.csv").open(newline="") as stream:
        header = next(csv.reader(stream))
    assert header[:2] == ["pose", "marker"]
    assert header[-3:] == ["x_mm", "y_mm", "z_mm"]
