"""Inverse runs as folders, pages and cells: their numbers are those of the result."""

import json
import re

import numpy as np
import pytest
from arm import EFFECTORS, arm, pose
from test_page import Read, check_page, number
from wording import says

from softcal_jax.control import ControlSettings, Limits, TrajectoryResult, solve_inverse
from softcal_jax.results import _write, notebook_html, write_results

FACTOR = {"N": 1.0, "mN": 1e-3, "mm": 1e-3, "N mm": 1e-3, "N m": 1.0}
FACTOR |= {"deg": np.pi / 180.0, "m": 1.0}

pytestmark = pytest.mark.filterwarnings("ignore::softcal_jax.results.PictureWarning")


@pytest.fixture(autouse=True)
def no_opengl(monkeypatch):
    """Pictures cost seconds; one test of the command line draws one."""
    monkeypatch.setattr(_write, "rendering_problem", lambda: "no OpenGL here")


def in_si(text):
    """The value of a cell like "1.5 N (imposed)" in SI."""
    match = re.match(r"(\S+) (N mm|N m|\w+)", text)
    assert match
    value, unit = match.groups()
    return float(value) * FACTOR[unit]


def searched(goal, **limits):
    start = pose((0.0, 0.0, 0.0), EFFECTORS, top=0.1, motor=0.1)
    settings = ControlSettings(other_starts=2)
    options = {"goals": {"bend": goal}, "limits": limits, "settings": settings}
    return solve_inverse(arm(), start, **options)


@pytest.fixture(scope="module")
def met():
    """The upper cable and the motor together turn the tip by 0.2 rad."""
    return searched(0.2)


@pytest.fixture(scope="module")
def missed():
    """So little tension and so small a turn bend it by much less."""
    turn = Limits(displacement=(0.0, 0.15))
    return searched(1.2, top=Limits(force=(0.0, 0.2)), motor=turn)


def check_actuators(rows, data):
    """Name, kind, force and displacement, each in a unit that reads well."""
    for row, actuator in zip(rows, data["actuators"], strict=True):
        name, kind, force, displacement = row
        assert name == actuator["name"]
        assert kind.startswith(actuator["kind"])
        assert ("not commanded" in kind) != actuator["commanded"]
        zero = 1e-4  # four digits are shown
        assert in_si(force) == pytest.approx(actuator["force"], rel=1e-3, abs=zero)
        assert in_si(displacement) == pytest.approx(
            actuator["displacement"], rel=1e-3, abs=zero
        )
        imposed = force if actuator["imposed"] == "force" else displacement
        assert "(imposed)" in imposed


def test_the_numbers_are_those_of_inverse_json(met, tmp_path):
    folder = write_results(met, tmp_path / "out", name="arm", notes=["mind the gap"])
    page = check_page(folder)
    data = json.loads((folder / "inverse.json").read_text())
    (point,) = data["points"]
    assert data["met"]
    assert point["met"]
    assert point["message"] in page.text
    assert page.text.count("Commanded: top = ") == 1
    note, left_out = data["notes"]
    assert note == "mind the gap"
    assert says(left_out, "command.png ... no OpenGL")
    assert page.text.index("mind the gap") < page.text.rindex("Goals and commands")
    _, row = page.tables["Goals"]
    (goal,) = point["goals"]
    assert (row[0], goal["unit"]) == ("bend", "rad")
    assert goal["goal"] == [pytest.approx(0.2)]
    assert in_si(row[1]) == pytest.approx(0.2, rel=1e-3)
    assert in_si(row[2]) == pytest.approx(goal["reached"][0], rel=1e-3)
    assert abs(goal["in_std"][0]) <= point["tol"]
    _, *rows = page.tables["Actuators"]
    check_actuators(rows, point)
    cable, _, motor = point["actuators"]
    assert cable["force"] == met.forces["top"] == met.inputs[0]
    assert motor["displacement"] == met.displacements["motor"]
    # What is imposed holds in the equilibrium up to rounding.
    assert met.displacements["motor"] == pytest.approx(met.inputs[1], rel=1e-12)
    assert motor["displacement_unit"] == "rad"
    assert rows[2][3].endswith("deg (imposed)")
    _, *rows = page.tables["Descents"]
    for row, attempt in zip(rows, point["attempts"], strict=True):
        assert row[0] == attempt["way"]
        assert int(row[1]) == attempt["n_steps"]
        assert number(row[2]) == pytest.approx(attempt["error"], rel=1e-2)
    assert "made in Python" in page.text
    assert [row[0] for row in page.tables["Files"]] == data["files"]
    assert "command.vtu" in data["files"]
    assert set(data["files"]) == {path.name for path in folder.iterdir()} - {
        "inverse.json",
        ".softcal-files",
    }


def test_a_missed_goal_is_no_success(missed, tmp_path):
    folder = write_results(missed, tmp_path / "out")
    page = check_page(folder)
    data = json.loads((folder / "inverse.json").read_text())
    assert not data["met"]
    (point,) = data["points"]
    assert point["held_by"]
    assert "is off by" in page.text
    for limit in point["active_limits"]:
        assert limit in page.text
    (verdict,) = (o for o in page.of("section") if "verdict" in o.get("class", ""))
    assert verdict["class"] == "verdict doubtful"


def test_a_cell_shows_what_the_page_shows(met, tmp_path):
    folder = write_results(met, tmp_path / "out")
    whole = Read((folder / "report.html").read_text("utf-8"))
    shown = Read(met._repr_html_())
    assert list(shown.tables) == ["Goals", "Actuators"]
    for title, rows in shown.tables.items():
        assert whole.tables[title] == rows
    assert "SI" not in shown.text


def test_a_trajectory(met, missed, tmp_path):
    """One command per goal, with the unit of each input."""
    result = TrajectoryResult((met, missed))
    folder = write_results(result, tmp_path / "out")
    page = check_page(folder)
    data = json.loads((folder / "inverse.json").read_text())
    assert [point["met"] for point in data["points"]] == [True, False]
    assert not data["met"]
    assert "1 of 2 goals are met." in page.text
    assert data["points"][1]["message"] in page.text
    _, *rows = page.tables["Commands"]
    for row, point in zip(rows, data["points"], strict=True):
        top, motor = (part.split(" = ")[1] for part in row[1].split(", "))
        forces = {actuator["name"]: actuator for actuator in point["actuators"]}
        assert in_si(top) == pytest.approx(forces["top"]["force"], rel=1e-3)
        assert in_si(motor) == pytest.approx(forces["motor"]["displacement"], rel=1e-3)
    assert {"goal_1.vtu", "goal_2.vtu", "configurations.pvd"} <= set(data["files"])
    assert Read(notebook_html(result)).tables["Commands"][1:] == rows
