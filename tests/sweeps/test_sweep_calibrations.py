"""Calibrations as trials, by Python and by the command line."""

import csv
import dataclasses
import json
import signal

import jax.numpy as jnp
import numpy as np
import pytest
from export.handmade import make_history, make_result
from killable import kill, wait_for
from rows import substance
from small_project import write_small_project
from test_page import Read, number
from wording import says

from softcal_jax._files import sha256_of
from softcal_jax.calibration import CalibrationSettings
from softcal_jax.cli import main
from softcal_jax.configurations import BodyFrame, Configuration
from softcal_jax.fields import random_starts
from softcal_jax.project import load_project
from softcal_jax.sweeps import Trial, _calibration, load_sweep, read_sweep
from softcal_jax.sweeps._calibration import CalibrationTrial, _with_noise, why_not

SWEEP = """
project = "project.toml"
seed = 7

[axes]
start = [0, 1]
noise = [0, 1]
"settings.max_steps" = [1, 50]
"shared.gravity" = ["(0, 0, -9.81) m/s^2", "(0, 0, -2e6) m/s^2"]
"""

WEIGHT, CRUSHED = "(0, 0, -9.81) m/s^2", "(0, 0, -2e6) m/s^2"


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A folder with a sweep that the command line has run, and what it printed."""
    folder = tmp_path_factory.mktemp("swept")
    write_small_project(
        folder, ("[markers]\n", "[newton]\nmax_steps = 5\n\n[markers]\n")
    )
    (folder / "sweep.toml").write_text(SWEEP)
    return folder


def run(folder, capsys, *more):
    """`softcal sweep` in this process."""
    code = main(["sweep", str(folder / "sweep.toml"), "--workers", "0", *more])
    return code, *capsys.readouterr()


def test_sweep_and_show(swept, capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    code, text, errors = run(swept, capsys)
    assert code == 1
    assert says(errors, "12 of 16 trials")
    assert says(text, "reading sweep.toml ... 16 trials")
    assert "failed: settings.max_steps = 1, shared.gravity = (0, 0, -2e6) m/s^2" in text
    assert says(text, "16 of 16", "4 converged, 4 not converged, 8 failed")
    assert says(text, "within max_steps = 1")
    assert "no equilibrium found" in text
    assert says(text, f"{swept / 'sweep'} ... softcal sweep show")
    assert f"open {swept / 'sweep_report.html'} in a browser" in text
    check_rows(swept)
    check_page(swept)
    # Once more: all is there.
    code, text, _ = run(swept, capsys)
    assert (code, "16 trials, 16 of them already done\n" in text) == (1, True)
    check_show(swept, capsys, tmp_path)


def check_rows(swept):
    """What trials found, against a calibration of the same by hand."""
    result = read_sweep(swept / "sweep")
    assert result.repeats == ("start", "noise")
    by_point = {tuple(r[axis] for axis in result.axes): r for r in result.rows}
    row = lambda start, noise: by_point[(50, WEIGHT, start, noise)]
    trial_at = lambda *at: Trial({a: row(*at)[a] for a in result.axes}, sweep_seed=7)
    exact = row(0, 0)
    assert exact["E [Pa]"] == pytest.approx(300e3, rel=1e-8)
    assert exact["held-out rms [m]"] < 1e-9
    assert set(result.figures) == {
        "fit rms [m]", "held-out rms [m]", "E [Pa]", "steps", "cost [-]",
        "standard error of E [Pa]",
    }  # fmt: skip
    # The same optimum from another start, on another way.
    other = row(1, 0)
    assert other["E [Pa]"] == pytest.approx(300e3, rel=1e-6)
    assert row(1, 1)["E [Pa]"] == pytest.approx(row(0, 1)["E [Pa]"], rel=1e-6)
    # By hand: the noise of the trial, on what is fitted and not on what is held out.
    project = load_project(swept / "project.toml")
    trial = trial_at(0, 1)
    random = np.random.default_rng(trial.seed_of("noise"))
    (pose,) = project.calibration
    std = np.array([[1e-4] * 3, [2e-4] * 3])  # tip and side
    noisy = pose.measured + std * random.standard_normal((2, 3))
    pose = dataclasses.replace(pose, measured=noisy)
    by_hand = dataclasses.replace(project, calibration=(pose,)).calibrate()
    noisy_row = row(0, 1)
    assert noisy_row["E [Pa]"] == pytest.approx(by_hand.value("E"), rel=1e-9)
    assert noisy_row["E [Pa]"] != pytest.approx(300e3, rel=1e-4)
    assert noisy_row["held-out rms [m]"] == pytest.approx(
        by_hand.configurations[1].rms_after, rel=1e-6
    )
    assert noisy_row["standard error of E [Pa]"] == pytest.approx(
        by_hand.parameters[0].standard_error, rel=1e-6
    )
    states = {p: r["state"] for p, r in by_point.items()}
    assert {s for p, s in states.items() if p[:2] == (1, WEIGHT)} == {"not converged"}
    assert {s for p, s in states.items() if p[1] == CRUSHED} == {"failed"}

    # The start of a trial is that of a calibration which is told to start there.
    started = trial_at(1, 0)
    z = random_starts(project.space, 1, seed=started.seed_of("start"))[0]
    elsewhere = project.calibrate(start=z)
    assert elsewhere.parameters[0].start == float(project.space.from_scaled(z)[0])
    assert elsewhere.history[0].values["E"] == elsewhere.parameters[0].start != 200e3
    assert len(elsewhere.history) - 1 == other["steps"]
    with pytest.raises(ValueError, match="1 param"):
        project.calibrate(start=jnp.zeros(2))


def check_page(swept):
    """Command, hashes, settings, and the numbers of the rows."""
    page = Read((swept / "sweep_report.html").read_text(encoding="utf-8"))
    assert says(page.text, "16 of 16 trials ... 4 converged")
    assert "softcal sweep sweep.toml -o repeated" in page.text
    files = ["sweep.toml", "project.toml", "markers.csv"]
    assert page.tables["Input files"][1:] == [
        [name, sha256_of(swept / name)] for name in files
    ]
    assert dict(page.tables["Settings"])["seed"] == "7"
    assert dict(page.tables["Versions"])["softcal_jax"]
    result = read_sweep(swept / "sweep")
    held_out = sorted(result.numbers("held-out rms [m]"))
    head, *rows = page.tables["Best trials"]
    shown = [number(row[head.index("held-out rms")]) for row in rows]
    np.testing.assert_allclose(shown, 1e3 * np.array(held_out), rtol=1e-3)


def check_show(swept, capsys, tmp_path):
    """Tables, CSV and picture of the rows."""
    show = lambda *more: main(["sweep", "show", str(swept / "sweep"), *more])
    table, picture = tmp_path / "t.csv", tmp_path / "p.png"
    assert show("--csv", str(table), "--plot", str(picture), "--figure", "E") == 0
    text, errors = capsys.readouterr()
    assert errors == ""
    assert says(text, "kPa")
    assert says(text, "Mean ± standard deviation")
    assert says(text, "Not converged, 4 trials", "settings.max_steps = 1")
    assert picture.read_bytes().startswith(b"\x89PNG")
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 16
    good = [float(r["E [Pa]"]) for r in rows if r["state"] == "converged"]
    assert len(good) == 4
    assert show("--all") == 0
    assert capsys.readouterr().out.count("failed") >= 8
    assert show("--figure", "F [Pa]") == 2
    assert says(capsys.readouterr().err, "error: ", "'F [Pa]'", "mean 'E [Pa]'")
    assert show("--by", "noisee") == 2
    assert says(capsys.readouterr().err, "'noisee' ... mean 'noise'")
    assert main(["sweep", "show", str(tmp_path / "no")]) == 2
    assert says(capsys.readouterr().err, "error: ", "no does not exist")


def test_a_folder_of_another_sweep_file(swept, capsys, tmp_path):
    write_small_project(tmp_path)
    (tmp_path / "sweep.toml").write_text(SWEEP.replace("seed = 7", "seed = 8"))
    read = swept / "other"
    assert main(["sweep", str(swept / "sweep.toml"), "--workers", "-1"]) == 2
    assert says(capsys.readouterr().err, "workers ... 0 or more, got -1")
    short = SWEEP.replace("[0, 1]", "[0]").replace("[1, 50]", "[1]")
    short = short.replace(f', "{CRUSHED}"', "")
    (swept / "sweep.toml").write_text(short)
    assert run(swept, capsys, "-o", str(read))[0] == 1
    code, _, errors = run(tmp_path, capsys, "-o", str(read))
    assert code == 2
    assert says(errors, "another sweep: ... seed is 7 ... 8")


def test_a_project_that_changes_while_a_sweep_runs(tmp_path, monkeypatch):
    write_small_project(tmp_path)
    (tmp_path / "sweep.toml").write_text(SWEEP)
    sweep = load_sweep(tmp_path / "sweep.toml")
    project = tmp_path / "project.toml"
    project.write_text(project.read_text().replace("nu = 0.3", "nu = 0.2"))
    monkeypatch.setattr(_calibration, "_KEPT", {})  # as in a new process
    with pytest.raises(RuntimeError, match=r"project\.toml has changed"):
        sweep.function(Trial(sweep.points[0]))


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_interrupted(swept, capsys, monkeypatch, sent):
    """Ctrl-C or SIGTERM: what is there stays, and the message says how to go on."""

    def interrupt(self, trial):
        signal.raise_signal(sent)

    monkeypatch.setattr(CalibrationTrial, "__call__", interrupt)
    code, _, errors = run(swept, capsys, "-o", str(swept / "third"))
    assert code == 130
    assert "0 of " in errors
    page = swept / "third_report.html"
    assert says(errors, f"same command ... third ... {page}")
    assert ">0 of " in page.read_text()


@pytest.mark.slow  # three processes compile a calibration, which takes minutes
def test_calibrations_do_not_depend_on_workers_or_kills(tmp_path):
    """Bit for bit: one worker undisturbed; two, killed twice and resumed."""
    import os
    import subprocess
    import sys

    from test_run_sweep import children

    write_small_project(tmp_path)
    text = SWEEP.replace("start = [0, 1]", "start = { count = 3 }").replace(
        "noise = [0, 1]", "noise = { count = 4 }"
    )
    (tmp_path / "sweep.toml").write_text(text.replace(f', "{CRUSHED}"', ""))
    sweep = load_sweep(tmp_path / "sweep.toml")
    expected = sweep.run(tmp_path / "one", workers=1)
    path = tmp_path / "two"
    command = [sys.executable, "-c", "from softcal_jax.cli import main; main()"]
    command += ["sweep", str(sweep.path), "-o", str(path), "--workers", "2"]

    def started(rows):
        driver = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        wait_for(driver, path, rows)
        return driver

    driver = started(2)
    os.kill(children(driver.pid)[0], signal.SIGKILL)
    wait_for(driver, path, 5)
    kill(driver)
    assert 5 <= len(read_sweep(path).rows) < 24
    result = sweep.run(path, workers=2)
    assert json.dumps(substance(result)) == json.dumps(substance(expected))


@pytest.mark.parametrize(
    ("steps", "rejected", "max_steps", "slope", "reason"),
    [
        (4, (4,), 4, 1.0, "within max_steps = 4"),
        (4, (), 50, 1.0, "within max_steps = 50"),
        (4, (3, 4), 50, 1.0, "last steps were refused"),
        (0, (), 50, np.nan, "sensitivities are not finite"),
    ],
)
def test_the_reason_of_a_row_is_what_happened(
    steps, rejected, max_steps, slope, reason
):
    """Steps before the last ones were accepted, so not every step was refused.

    Steps of tensors that find no way on from an optimum are not in the history.
    """
    history = make_history(rejected)[: steps + 1]
    result = make_result(converged=False, history=history)
    settings = CalibrationSettings(max_steps=max_steps)
    linear = dataclasses.replace(result.linear, W=slope * result.linear.W)
    result = dataclasses.replace(result, settings=settings, linear=linear)
    assert says(why_not(result), reason)


def test_noise_is_for_markers_alone():
    """A pose that measures a sensor, too, must not pass for one that has its noise."""
    sensor = Configuration("pose", ("x_min",), effectors=[BodyFrame("sensor", "plate")])
    with pytest.raises(ValueError, match=r"'pose' .*markers.* leave the axis"):
        _with_noise(sensor, np.random.default_rng(0))
