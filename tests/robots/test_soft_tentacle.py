"""The packaged tentacle: body, tendons, poses and readings, without a fit."""

import tomllib
from ast import literal_eval

import numpy as np
import pytest

from benchmarks import _tentacle_mesh
from softcal_jax.configurations import read_markers
from softcal_jax.mesh import volumes
from softcal_jax.project import load_project
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


def test_figures():
    """One pose of the source's table, typed by hand."""
    file = FOLDER / "static_markers.csv"
    pose = read_markers(file, select={"pose": "m2_018"})
    assert pose.names == ("p1", "p2", "p3", "p4")
    np.testing.assert_allclose(
        pose.positions_of(["p4"]), [[0.0937189, -0.1509909, -0.1807376]], rtol=1e-12
    )


def test_poses(project):
    """Held out are all poses of another session, most between the fitted ones."""
    fitted, held_out = project.calibration, project.validation
    assert len(fitted) == 8
    assert len(held_out) == 6
    assert not any("_" in c.name for c in fitted)
    assert all("_" in c.name for c in held_out)


@pytest.mark.parametrize("tendon", ANGLES)
def test_tensions(project, tendon):
    """The torques of the table, over the radius of the pulley."""
    rows = np.genfromtxt(
        FOLDER / "static_markers.csv", delimiter=",", names=True, dtype=None
    )
    column = f"torque_{tendon[-1]}_Nm"
    torques = {str(row["pose"]): float(row[column]) for row in rows}
    pulled = [c for c in project.configurations if tendon in c.actuation]
    assert len(pulled) == 7
    for pose in pulled:
        assert list(pose.actuation) == [tendon]
        tension = pose.actuation[tendon].value
        assert tension == pytest.approx(torques[pose.name] / PULLEY, rel=1e-4)


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
