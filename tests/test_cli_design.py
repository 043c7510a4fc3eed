"""From goals in a project file to a printed robot that is calibrated, by commands."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from wording import says

from softcal_jax.cli import main
from softcal_jax.project import ProjectError, _goals, load_project

PROJECT = """\
name = "finger"

[mesh]
element = "linear"
beam = { size = "(100, 20, 20) mm", cells = [4, 1, 1] }

[material]
law = "corotational"
elasticity = "reduced-transverse-isotropic"
E_t = "400 kPa"
E_l = "300 kPa"
nu = 0.3
theta = "0 deg"
print_plane = "xy"
density = "500 kg/m^3"

[actuators.cable]
type = "cable"
guides = ["(0, 10, 2) mm", "(50, 10, 2) mm", "(100, 10, 2) mm"]

[control_points.ends]
positions = { root = "(0, 10, 10) mm", tip = "(100, 10, 10) mm" }

[[parameters]]
field = "E_t"
control_points = "ends"
interpolation = "log"
lower = "50 kPa"
upper = "5 MPa"

[[parameters]]
field = "E_l"
control_points = "ends"
interpolation = "log"
lower = "50 kPa"
upper = "3 MPa"

[markers]
std = "0.3 mm"

[markers.positions]
half = "(50, 10, 10) mm"
tip = "(100, 10, 10) mm"

[shared]
gravity = "(0, 0, 0) m/s^2"
supports = [{ group = "x_min" }]
actuation = { cable = "0.1 N" }

[[configurations]]
name = "bent"
goal = { half = "(-, 10, 8.9) mm", tip = "(-, 10, 5) mm" }

[[configurations]]
name = "curled"
goal = { half = "(-, 10, 7.8) mm", tip = "(-, 10, 0) mm" }

[design]
foam = "Polyfoam"
limits = { cable = "0 N to 6 N" }

[settings]
starts = 1
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    path = tmp_path_factory.mktemp("designed") / "project.toml"
    path.write_text(PROJECT.replace("[design]", "[design]\nlargest_stretch = 1.5"))
    return path


@pytest.fixture(scope="module")
def designed(project):
    out = project.parent / "design"
    assert main(["design", str(project), "-o", str(out), "-q", "--no-pictures"]) == 0
    return out


def test_goals_are_read_as_typed(project):
    asked = load_project(project).asked
    bent, curled = asked.goals
    for goal, heights in ((bent, [8.9e-3, 5e-3]), (curled, [7.8e-3, 0.0])):
        assert goal.markers is not None
        assert goal.markers.axes == "yz"
        np.testing.assert_allclose(np.asarray(goal.measured)[:, 2], heights)
    assert asked.limits["cable"].force == (0.0, 6.0)
    assert asked.foam is not None
    assert asked.foam.infill == "Polyfoam"
    assert asked.printing.angle == pytest.approx(np.deg2rad(20.0))


def test_what_a_design_may_be_asked_for(tmp_path):
    more = """[design]
robust = true
modulus_change = "30 %"
angle_change = "20 deg"
largest_stretch = 1.5
largest_stress = "0.2 MPa"
"""
    (tmp_path / "project.toml").write_text(PROJECT.replace("[design]", more))
    asked = load_project(tmp_path / "project.toml").asked
    assert asked.robust
    assert vars(asked.change) == pytest.approx(
        {"moduli": 0.3, "angle": np.deg2rad(20.0)}
    )
    assert vars(asked.largest) == pytest.approx({"stretch": 1.5, "stress": 2e5})
    (tmp_path / "project.toml").write_text(PROJECT)
    asked = load_project(tmp_path / "project.toml").asked
    assert (asked.robust, asked.change, asked.largest.given) == (False, None, {})


def test_the_folder_says_what_to_order_and_to_command(designed):
    data = json.loads((designed / "design.json").read_text())
    found = data["design"]
    assert found["met"]
    assert {*found["commands"]} == {"bent", "curled"}
    assert (
        0.0 < found["commands"]["bent"]["cable"] < found["commands"]["curled"]["cable"]
    )
    errors = found["alternatives"]
    assert found["error"] < errors["the best homogeneous material"]
    assert "Designed: all 4 goals are met" in (designed / "report.html").read_text()
    assert not (designed / "icesl" / "unreachable.csv").exists()
    assert (designed / "icesl" / "robot.lua").exists()


def test_the_printed_robot_is_a_project_of_its_own(designed):
    """It begins at the design, with errors of printing as priors."""
    found = json.loads((designed / "design.json").read_text())["design"]
    printed = load_project(designed / "project.toml")
    assert printed.asked.goals == ()
    values = {q.name: float(q.start) for q in printed.parameters}
    assert values == pytest.approx(found["values"], rel=1e-8)
    assert [q.prior_std for q in printed.parameters] == pytest.approx([0.3] * 4)
    commands = {c.name: c.actuation["cable"].value for c in printed.configurations}
    ordered = {name: c["cable"] for name, c in found["commands"].items()}
    assert commands == pytest.approx(ordered, rel=1e-8)
    simulated, _ = printed.simulate()
    assert simulated.converged
    # The markers are where the design has them, within a tolerance.
    heights = [p.simulated[2] for c in simulated.configurations for p in c.points]
    np.testing.assert_allclose(heights, [8.9e-3, 5e-3, 7.8e-3, 0.0], atol=3e-4)


def write_poses_of_the_print(design, folder):
    """Poses of a robot whose root is a fifth softer than ordered, in its project."""
    printed = load_project(design / "project.toml")
    true = {q.name: float(q.start) for q in printed.parameters}
    true |= {name: 0.8 * value for name, value in true.items() if "root" in name}
    simulated, _ = printed.simulate(true)
    raw = tomllib.loads((design / "project.toml").read_text())
    lines = ["configuration,marker,x_mm,y_mm,z_mm"]
    for pose in simulated.configurations:
        for p in pose.points:
            x, y, z = 1e3 * p.simulated
            lines.append(f"{pose.name},{p.name},{x:.9f},{y:.9f},{z:.9f}")
    assert [table["name"] for table in raw["configurations"]] == ["bent", "curled"]
    (folder / "poses.csv").write_text("\n".join(lines))
    text = (design / "project.toml").read_text()
    for name in ("bent", "curled"):
        select = f'{{ configuration = "{name}" }}'
        measured = f'measured = {{ file = "poses.csv", select = {select} }}'
        text = text.replace(f'name = "{name}"', f'name = "{name}"\n{measured}')
    (folder / "project.toml").write_text(text)


@pytest.mark.slow
def test_poses_of_the_print_calibrate_it(designed, tmp_path):
    """Found again, from the same project."""
    write_poses_of_the_print(designed, tmp_path)
    result = load_project(tmp_path / "project.toml").calibrate()
    assert result.converged
    found = {p.name: p.value / p.start for p in result.parameters}
    assert found["E_l of root"] == pytest.approx(0.8, abs=0.05)


def test_a_missed_goal_is_exit_code_one(project, tmp_path, capsys):
    weak = project.read_text().replace("0 N to 6 N", "0 N to 0.3 N")
    (tmp_path / "project.toml").write_text(weak)
    args = ["design", str(tmp_path / "project.toml"), "-o", str(tmp_path / "out")]
    assert main([*args, "--no-pictures"]) == 1
    out = capsys.readouterr().out
    assert says(out, "Not designed", "goals are missed", "held by")
    found = json.loads((tmp_path / "out" / "design.json").read_text())["design"]
    assert "largest stretch" in out
    peaks = [(p["configuration"], p["limit"]) for p in found["peaks"]]
    assert peaks == [("bent", 1.5), ("curled", 1.5)]
    assert all(1.0 < p["value"] < 1.5 for p in found["peaks"])
    assert "largest stretch" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('tip = "(-, 10, 5) mm"', 'tpi = "(-, 10, 5) mm"', "goal ... 'tpi' ... 'tip'"),
        ('"(-, 10, 5) mm"', '"(-, -, -) mm"', "goal ... every coordinate free"),
        ("0 N to 6 N", "6 N", "limits.cable ... lowest to highest"),
        ("0 N to 6 N", "0 N to 6 mm", "limits.cable ... different kinds"),
        ("limits = { cable", "limits = { cabel", "limits.cabel ... cable"),
        ("[design]", "[design]\nlargest_stretch = 0.9", "design ... above 1 ... 0.9"),
        (
            'foam = "Polyfoam"',
            'foam = "Polyfaom"',
            'design.foam: got "Polyfaom" ... "none" ... mean "Polyfoam"',
        ),
        ('foam = "Polyfoam"', 'foam = "Phasor"', "no moduli of Phasor ... table"),
        ('foam = "Polyfoam"', 'solid_modulus = "9 MPa"', "solid_modulus ... foam"),
        (
            'foam = "Polyfoam"',
            'foam = "Polyfoam"\ntable = "a.csv"\nsolid_modulus = "9 MPa"',
            "design ... solid_modulus ... table",
        ),
        ("starts = 1", 'starts = 1\n[uncertain]\nnu = "x"', "uncertain.nu"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, old, new, message):
    assert old in PROJECT
    (tmp_path / "project.toml").write_text(PROJECT.replace(old, new))
    with pytest.raises(ProjectError) as error:
        load_project(tmp_path / "project.toml")
    assert says(error.value, *message.split(" ... "))


def test_a_project_without_goals(project, tmp_path, capsys):
    plain = PROJECT.partition("[[configurations]]")[0]
    plain += '[[configurations]]\nname = "free"\n'
    (tmp_path / "project.toml").write_text(plain)
    args = ["design", str(tmp_path / "project.toml"), "-o", str(tmp_path / "out")]
    assert main(args) == 2
    assert says(capsys.readouterr().err, "none has a goal", "goal = {")


def test_files_are_found_from_the_folder_of_the_design():
    """A mesh file beside the project, and the photographs of a pose."""
    top = {"photos": ["a.jpg"], "board": "../b.jpg", "name": "file"}
    measured = {"effectors": {"sensor": top}}
    raw = {"mesh": {"file": "finger.msh"}, "configurations": [{"measured": measured}]}
    moved = _goals._moved(raw, Path(".."))
    assert moved["mesh"] == {"file": "../finger.msh"}
    there = {"photos": ["../a.jpg"], "board": "../../b.jpg", "name": "file"}
    there = {"effectors": {"sensor": there}}
    assert moved["configurations"] == [{"measured": there}]
