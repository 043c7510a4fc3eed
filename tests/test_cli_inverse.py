"""`softcal inverse`: from a calibrated folder to the command for a goal."""

import json
import signal
from types import SimpleNamespace

import numpy as np
import pytest
from small_project import sha256_of, write_small_project
from test_page import Read, check_page
from wording import says

from softcal_jax.calibration import Evaluator
from softcal_jax.cli import main
from softcal_jax.control import sample_workspace
from softcal_jax.equilibrium import solve_equilibrium
from softcal_jax.fields import ParameterSpace, load_factor
from softcal_jax.results import load_result

PUSH = """\
[actuators.push]
type = "point-force"
point = "(60, 10, 20) mm"
direction = "-z"

[effectors.end]
type = "centroid"
group = "tip"

[effectors.pushed]
type = "actuator-force"
actuator = "push"
std = "1 mN"

[settings]
intervals = 0

[uncertain]
nu = 0.0
density = 0
gravity = 0
loads = 0
actuators = 0
clamp = 0
recordings = 0
mesh = 0

[markers]
std = "0.1 mm"
"""


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """A folder with a calibration of the small project, which a force can push."""
    folder = tmp_path_factory.mktemp("pushed")
    path = write_small_project(
        folder,
        ('[markers]\nstd = "0.1 mm"\n', PUSH),
        ('supports = [{ group = "x_min" }]\n',
         'supports = [{ group = "x_min" }]\neffectors = []\n'),
        ('name = "weight"\n', 'name = "weight"\nactuation = { push = "0 mN" }\n'),
    )  # fmt: skip
    assert (
        main(["calibrate", str(path), "-o", str(folder / "out"), "--no-pictures"]) == 0
    )
    return folder


def run(calibrated, where, *more):
    given = ["inverse", str(calibrated / "out"), "-o", str(where), "--no-pictures"]
    return main([*given, *more])


WEIGHT = ("--configuration", "weight")


def test_the_force_that_brings_the_tip_to_a_height(calibrated, tmp_path, capsys):
    """It is met in z alone, and the forward model with that force gets there."""
    out = tmp_path / "out"
    goal = "tip=(-, -, 8) mm"
    assert (
        run(calibrated, out, *WEIGHT, "--goal", goal, "--limit", "push=0 N to 1 N") == 0
    )
    printed, errors = capsys.readouterr()
    assert errors == ""
    assert "push is commanded" in printed
    assert "all goals are met" in printed
    data = json.loads((out / "inverse.json").read_text())
    (point,) = data["points"]
    (aimed,) = point["goals"]
    assert aimed["goal"] == [None, None, pytest.approx(8e-3)]
    assert aimed["reached"][2] == pytest.approx(8e-3, abs=1e-6)
    (push,) = point["actuators"]
    assert push["commanded"]
    assert 0.0 < push["force"] < 1.0

    loaded = load_result(calibrated / "out")
    assert data["calibration"]["sha256"] == sha256_of(loaded.path)
    again = sample_workspace(loaded.model, loaded.posed("weight")[0], [[push["force"]]])
    np.testing.assert_allclose(again.effectors["tip"][0, 0, 2], 8e-3, atol=1e-6)

    page = check_page(out)
    command = f"softcal inverse {data['calibration']['file']} --configuration weight"
    quoted = "--goal 'tip=(-, -, 8) mm' --limit 'push=0 N to 1 N' -o repeated"
    assert f"{command} {quoted}" in page.text
    files = dict(page.tables["Input files"][1:])
    assert set(files.values()) == {
        sha256_of(calibrated / name)
        for name in ("out/result.json", "project.toml", "markers.csv")
    }
    assert "Goals" in page.tables


def test_a_calibrated_pose_is_a_start(calibrated, tmp_path):
    """Its equilibrium was written, and Newton's method has nothing left to do there."""
    loaded = load_result(calibrated / "out")
    _, lane = loaded.posed("weight")
    guess = loaded.displacement("weight")
    solved = solve_equilibrium(loaded.model, lane, guess=guess)
    assert solved.converged
    assert int(solved.steps) <= 1 < int(solve_equilibrium(loaded.model, lane).steps)
    np.testing.assert_allclose(solved.displacement, guess, atol=1e-9)
    state = loaded.state_of("weight")
    state.rename(tmp_path / "weight.vtu")
    try:
        assert loaded.displacement("weight") is None
    finally:
        (tmp_path / "weight.vtu").rename(state)


def test_a_damaged_state_is_named(calibrated, tmp_path, capsys):
    """So the command reads it."""
    state = load_result(calibrated / "out").state_of("weight")
    content = state.read_bytes()
    state.write_text("no xml")
    try:
        assert (
            run(calibrated, tmp_path / "out", *WEIGHT, "--goal", "tip=(-, -, 8) mm")
            == 2
        )
    finally:
        state.write_bytes(content)
    assert says(capsys.readouterr().err, "weight.vtu cannot be read", "calibrate again")


def test_sigterm_writes_the_best_so_far(calibrated, tmp_path, capsys, monkeypatch):
    steps, evaluated = iter(range(1, 100)), Evaluator.__call__

    def interrupted(*args):
        if next(steps) == 2:
            signal.raise_signal(signal.SIGTERM)
        return evaluated(*args)

    monkeypatch.setattr(Evaluator, "__call__", interrupted)
    more = ["--goal", "tip=(-, -, 8) mm", "--limit", "push=0 N to 1 N"]
    assert run(calibrated, tmp_path / "out", *WEIGHT, *more) == 130
    assert says(capsys.readouterr().err, "interrupted", "best actuation so far")
    data = json.loads((tmp_path / "out" / "inverse.json").read_text())
    assert data["met"] is False
    assert says(data["points"][0]["outcome"], "interrupted")
    assert "command.vtu" in data["files"]
    assert (tmp_path / "out" / "report.html").exists()


def test_out_of_reach_of_the_limits(calibrated, tmp_path, capsys):
    """The nearest point is written, what holds it is said, and the exit code is 1."""
    out = tmp_path / "out"
    more = ["--goal", "end=(60, 10, 0) mm", "--limit", "push=0 mN to 10 mN"]
    assert run(calibrated, out, *WEIGHT, *more, "--json") == 1
    printed, errors = capsys.readouterr()
    data = json.loads(printed)
    assert not data["met"]
    assert data["points"][0]["held_by"]
    assert data["points"][0]["actuators"][0]["force"] == pytest.approx(10e-3)
    assert "nearest reachable point" in errors
    assert "'end' is off by" in Read((out / "report.html").read_text()).text


def test_an_actuator_that_the_configuration_does_not_command(calibrated, tmp_path):
    """`--start` commands it, and a scalar is a goal as well."""
    out = tmp_path / "out"
    more = [
        "--configuration",
        "pulled",
        "--start",
        "push=1 mN",
        "--goal",
        "pushed=7 mN",
    ]
    assert run(calibrated, out, *more) == 0
    (point,) = json.loads((out / "inverse.json").read_text())["points"]
    assert point["actuators"][0]["force"] == pytest.approx(7e-3, abs=1e-5)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--goal", "tip=(1, 2, 3) mm"], "configurations 'weight' and 'pulled'"),
        ([*WEIGHT, "--goal", "tip"], "--goal: got 'tip' ... --goal tip="),
        ([*WEIGHT, "--goal", "tpi=(1, 2, 3) mm"], "Did you mean 'tip'?"),
        ([*WEIGHT, "--goal", "tip=(1, 2, 3)"], "'tip': \"(1, 2, 3)\" has no unit"),
        ([*WEIGHT, "--goal", "tip=5 mm"], "'tip': got \"5 mm\""),
        ([*WEIGHT, "--goal", "tip=(-, -, -) mm"], "leaves every coordinate free"),
        ([*WEIGHT, "--goal", "tip=(-, -, 8) mm", "--goal", "side=(-, 1, 2) mm"],
         "leave different coordinates free"),
        ([*WEIGHT, "--goal", "pushed=7 mm"], "goal of 'pushed': "),
        ([*WEIGHT, "--goal", "end={ position = 1"], "no inline table"),
        ([*WEIGHT, "--goal", "end={ }\nother = { }"], "inline table ... after its end"),
        ([*WEIGHT, "--goal", "end=" + "{a=" * 3000], "no inline table"),
        ([*WEIGHT, "--goal", "tip=(1, 2, 3) mm", "--goal", "tip=(1, 2, 4) mm"],
         "'tip' ... twice"),
        ([*WEIGHT, "--goal", "tip=(1, 2, 3) mm", "--limit", "pull=0 N to 1 N"],
         "limit of 'pull': there is no actuator \"pull\" ... push"),
        ([*WEIGHT, "--goal", "tip=(1, 2, 3) mm", "--limit", "push=5 N"],
         "limit of 'push': got '5 N' ... lowest ... highest"),
        ([*WEIGHT, "--goal", "tip=(1, 2, 3) mm", "--limit", "push=0 N to 5 mm"],
         "are of different kinds"),
        ([*WEIGHT, "--goal", "tip=(1, 2, 3) mm", "--limit", "push=0 N to 5 kPa"],
         "limit of 'push': got \"5 kPa\""),
        ([*WEIGHT, "--goal", "tip=(1, 2, 3) mm", "--limit", "push=1 N to 2 N"],
         "starts outside its limits"),
        (["--configuration", "pulled", "--goal", "tip=(1, 2, 3) mm"],
         "commands no actuator"),
    ],
)  # fmt: skip
def test_bad_input(calibrated, tmp_path, capsys, more, message):
    """It is named with what was expected, and nothing is written."""
    assert run(calibrated, tmp_path / "out", *more) == 2
    assert says(capsys.readouterr().err, message)
    assert not (tmp_path / "out").exists()


def test_a_value_of_the_configurations_is_refused(
    calibrated, tmp_path, capsys, monkeypatch
):
    """A load factor says nothing of a command that is not one of the recordings."""
    loaded = load_result(calibrated / "out")
    entries = *loaded.space.entries, load_factor("weight", prior_std=None)
    of_loads = SimpleNamespace(project=loaded.project, space=ParameterSpace(entries))
    monkeypatch.setattr("softcal_jax.results.load_result", lambda *_, **__: of_loads)
    more = ["--goal", "tip=(-, -, 8) mm"]
    assert run(calibrated, tmp_path / "out", *WEIGHT, *more) == 2
    assert says(capsys.readouterr().err, "load factor of weight")
