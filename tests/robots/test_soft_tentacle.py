"""The packaged tentacle: body, tendons, poses and readings, without a fit."""

import tomllib
from ast import literal_eval
from shutil import copytree

import numpy as np
import pytest

from benchmarks import _tentacle_mesh
from softcal_jax.mesh import volumes
from softcal_jax.project import ProjectError, load_project
from softcal_jax.robots import ready_made_path

FOLDER = ready_made_path("tentacle").parent

PULLEY = 32.5e-3
"""Radius of the pulleys of the motors [m]."""

ANGLES = {"tendon 1": 30.0, "tendon 2": 150.0}
"""Of the tendons about the axis, from y to x [deg]."""


@pytest.fixture(scope="module")
def project():
    return load_project(FOLDER / "project.toml", solve=False)


def radius(depth):
    """The radius of the body, as the authors' script has it [mm]."""
    return np.interp(depth, [0.0, 305.0, 360.0], [15.41, 6.42, 4.80])


def test_files():
    source = " ".join((FOLDER / "README.md").read_text().split())
    assert "tud-phi/soromox" in source
    assert "MIT licence" in source
    assert "MIT" in (FOLDER / "LICENSE-recordings.txt").read_text()


def test_readings(project):
    """Two poses of the authors' table of means, typed by hand; the robot drifts."""
    pose = {c.name: c for c in project.configurations}
    assert pose["m2_018"].markers.names == ("p1", "p2", "p3", "p4")
    tip = pose["m2_018"].measured[3]
    np.testing.assert_allclose(tip, [0.0937189, -0.1509909, -0.1807376], atol=1e-5)
    whole = [
        [0.0302523, 0.0020687, -0.1355361],
        [-0.0095580, 0.0189019, -0.2213397],
        [0.0409111, 0.0441615, -0.2648422],
        [0.0534472, 0.1138177, -0.3174834],
    ]
    np.testing.assert_allclose(pose["m1u01"].measured, whole, atol=1e-4)


def test_axes_of_the_cameras_are_a_turn(tmp_path):
    text = (FOLDER / "project.toml").read_text()
    for old, new in (('"-y"', '"y"'), ('"-y"', '"x"')):
        copytree(FOLDER, tmp_path / new)
        (tmp_path / new / "project.toml").write_text(text.replace(old, new))
        with pytest.raises(ProjectError, match=r"axes x, z, . are no turn.*mirror"):
            load_project(tmp_path / new / "project.toml", solve=False)


def test_poses(project):
    """Held out are all poses of another session, most between the fitted ones."""
    fitted, held_out = project.calibration, project.validation
    assert len(fitted) == 8
    assert len(held_out) == 6
    assert not any("_" in c.name for c in fitted)
    assert all("_" in c.name for c in held_out)


@pytest.mark.parametrize("tendon", ANGLES)
def test_tensions(project, tendon):
    """The torques that the names state, over the radius of the pulley."""
    pulled = [c for c in project.configurations if tendon in c.actuation]
    assert len(pulled) == 7
    for pose in pulled:
        assert list(pose.actuation) == [tendon]
        assert pose.name[1] == tendon[-1]
        torque = float(f"0.{pose.name[4:]}")
        tension = pose.actuation[tendon].value
        assert tension == pytest.approx(torque / PULLEY, rel=1e-4)


@pytest.mark.parametrize("tendon", ANGLES)
def test_tendons(tendon):
    """From the clamp to the end of the first link, ever nearer to the axis."""
    file = tomllib.loads((FOLDER / "project.toml").read_text())
    guides = file["actuators"][tendon]["guides"]
    x, y, z = np.array([literal_eval(g.removesuffix(" mm")) for g in guides]).T
    assert z[0] == 0.0
    assert z[-1] == pytest.approx(-305.0)
    np.testing.assert_allclose(np.hypot(x, y), 11.4 + 0.0295 * z, atol=2e-3)
    off = np.rad2deg(np.arctan2(x, y)) - ANGLES[tendon]
    np.testing.assert_allclose(off, 0.0, atol=0.05)


def test_body(project):
    """Dimensions of the authors; the volume is that of the cones within 1 %."""
    mesh = project.model.mesh
    assert mesh.order == 2
    low, high = (1e3 * end(mesh.points, axis=0) for end in (np.min, np.max))
    np.testing.assert_allclose([low[2], high[2]], [-360.0, 0.0], atol=1e-9)
    depth = np.linspace(0.0, 360.0, 10001)
    cones = np.trapezoid(np.pi * radius(depth) ** 2, depth)
    assert 1e9 * np.sum(volumes(mesh)) == pytest.approx(cones, rel=0.01)


def test_the_mesh_is_what_its_script_makes(project):
    made = _tentacle_mesh.tentacle(26, 6)
    corners = 1e3 * project.model.mesh.points[: len(made.points)]
    np.testing.assert_allclose(corners, made.points, atol=1e-9)
    assert len(made.cells_dict["tetra"]) == len(project.model.mesh.tets)


@pytest.mark.parametrize("sides", [5, 6, 8])
@pytest.mark.parametrize("depth", [0.0, 305.0, 360.0])
def test_sections_are_as_stiff_as_circles(sides, depth):
    """The second moment of the area of the polygon, by the formula for polygons."""
    x, y, _ = _tentacle_mesh.section(depth, sides)[1:].T
    next_x, next_y = np.roll(x, -1), np.roll(y, -1)
    cross = x * next_y - next_x * y
    second = np.sum(cross * (x * x + x * next_x + next_x**2)) / 12.0
    assert second == pytest.approx(np.pi / 4.0 * radius(depth) ** 4, rel=1e-12)
