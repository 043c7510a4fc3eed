"""The command line: exit codes, what is printed, and what is left on the disk."""

import csv
import json
import re
import signal
import subprocess
import sys
from importlib.metadata import version

import numpy as np
import pytest
from small_project import sha256_of, write_small_project
from wording import says

from softcal_jax.calibration import Evaluator
from softcal_jax.cli import main
from softcal_jax.mistakes import Mistake
from softcal_jax.results import results_folder
from softcal_jax.robots import ready_made_path


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def left_behind(folder):
    """Everything in a folder that the project did not bring, hidden files too."""
    return {p.name for p in folder.iterdir()} - {"project.toml", "markers.csv"}


def test_version():
    done = subprocess.run(
        [sys.executable, "-m", "softcal_jax", "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"softcal {version('softcal-jax')}\n"


def test_a_command_does_not_wait_for_what_it_may_not_need():
    """Drawing, optimisers, units; seconds of imports before every command.

    Nor does the package alone, for pydantic and reports.
    """
    heavy = ["pyvista", "matplotlib", "vtkmodules", "optimistix", "pandas", "pint"]
    heavy += ["jaxopt", "scipy.stats", "scipy.optimize", "scipy.interpolate"]
    code = f"""
import sys, softcal_jax
print(*{{"pydantic", "pint", "softcal_jax.results"}} & set(sys.modules))
softcal_jax.load_project, softcal_jax.write_results
import softcal_jax.cli, softcal_jax.project, softcal_jax.results
print(*set({heavy}) & set(sys.modules))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []


def test_help(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert "softcal new my_robot" in text
    for code in ("  0  done", "  1  not converged", "  2  bad input", "130  inter"):
        assert code in text


@pytest.mark.parametrize(
    "argv", [[], ["callibrate"], ["calibrate", "p.toml"], ["identify"]]
)
def test_wrong_usage(argv, capsys):
    with pytest.raises(SystemExit) as caught:
        main(argv)
    assert caught.value.code == 2
    assert "usage: softcal" in capsys.readouterr().err


def test_calibrate(tmp_path, out, capsys):
    path = write_small_project(tmp_path)
    assert main(["calibrate", str(path), "-o", str(out)]) == 0
    text, errors = capsys.readouterr()
    assert errors == ""
    assert "16 nodes, 18 linear tets, NeoHookean (displacement)" in text
    assert "fit: weight\npredict: pulled\n" in text
    assert says(text, "rms ", "weight 0.00 mm, pulled 0.00 mm")
    assert "step 1 " in text
    assert "E = 300.00 kPa" in text
    assert says(
        text,
        "Preliminary values",
        "E = ... kPa",
        "Residuals: 0.00 mm",
        "pulled: 0.00 mm",
    )
    assert text.index("Preliminary values") < text.index("the error budget (")
    assert "predicting pulled ..." in text
    assert says(text, "Held-out", "pulled: 0.00 mm", "2 markers, 0.0 %")
    assert f"Results in {out}: open {out / 'report.html'} in a browser" in text
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "softcal calibrate ../project.toml -o repeated" in page
    for part in ("import", "reading", "compile", "solve", "results and pictures"):
        assert f"{part} " in text.split("Time: ")[1]

    result = json.loads((out / "result.json").read_text())
    assert result["converged"]
    (E,) = result["parameters"]
    assert E["value"] == pytest.approx(300e3, rel=1e-8)
    assert {"import", "reading", "compile", "solve"} <= set(result["timing_s"])
    assert {"weight.vtu", "pulled.vtu"} <= {p.name for p in out.iterdir()}
    assert left_behind(tmp_path) == {"out"}

    new = tmp_path / "new"
    argv = ["simulate", str(path), "--values", str(out), "-o", str(new)]
    assert main([*argv, "--no-pictures"]) == 0
    text = capsys.readouterr().out
    assert says(
        text, f"values of {out}: E\n", "Prediction error of 2 poses: 0.00 mm rms"
    )
    page = (new / "report.html").read_text(encoding="utf-8")
    assert "--values ../out/result.json -o repeated" in page
    for pose in json.loads((new / "simulation.json").read_text())["configurations"]:
        assert pose["rms_after_mm"] < 1e-6 < pose["motion_mm"]
        assert pose["markers"][0]["measured_mm"] is not None

    # Once more: refused, and untouched; nothing was even read.
    before = (out / "result.json").stat().st_mtime_ns
    assert main(["calibrate", str(tmp_path / "no.toml"), "-o", str(out)]) == 2
    assert says(capsys.readouterr().err, "not empty ... --force")
    assert (out / "result.json").stat().st_mtime_ns == before


def test_force_replaces_and_not_converged_says_so(tmp_path, out, capsys):
    """One step is too few: the results are there, marked, and the exit code is 1."""
    settings = "[settings]\nmax_steps = 1\n\n[markers]\n"
    path = write_small_project(tmp_path, ("[markers]\n", settings))
    with results_folder(out) as earlier:
        (earlier / "result.json").write_text("{}")
    command = ["calibrate", str(path), "-o", str(out), "--no-pictures"]
    assert main([*command, "--force"]) == 1
    text, errors = capsys.readouterr()
    assert says(errors, "not converged ... 1 steps")
    assert "Do not use these values" in text
    assert json.loads((out / "result.json").read_text())["converged"] is False


@pytest.mark.parametrize(
    "sent", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_ctrl_c_writes_what_has_been_fitted(tmp_path, out, capsys, monkeypatch, sent):
    """So does SIGTERM, by which a scheduler ends a job; the checkpoint stands."""
    path = write_small_project(tmp_path)
    checkpoint = tmp_path / "fit.npz"
    steps, evaluated = iter(range(1, 100)), Evaluator.__call__

    def interrupted(*args):
        if next(steps) == 2:
            signal.raise_signal(sent)
        return evaluated(*args)

    monkeypatch.setattr(Evaluator, "__call__", interrupted)
    command = ["calibrate", str(path), "-o", str(out), "--checkpoint", str(checkpoint)]
    command.append("--no-pictures")
    assert main(command) == 130
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    text, errors = capsys.readouterr()
    assert says(errors, "interrupted", "1 steps", "not converged")
    assert stands(errors, checkpoint)
    assert "Do not use these values" in text
    result = json.loads((out / "result.json").read_text())
    assert result["converged"] is False
    assert says(result["notes"][0], "Interrupted ... step 1")
    monkeypatch.undo()
    assert main([*command, "--force"]) == 0
    assert "Do not use" not in capsys.readouterr().out


@pytest.mark.parametrize("stopped", [False, True])
def test_the_likeliest_mistake_stands_before_the_verdict(
    tmp_path, out, capsys, monkeypatch, stopped
):
    """Where the data contradict the model; Ctrl-C in the search loses nothing."""
    tip, side = 'tip = "(60, 10, 10) mm"', 'side = { position = "(60, 20, 0) mm"'
    moved = 'tip = "(60, 20, 0) mm"', 'side = { position = "(0, 10, 10) mm"'
    path = write_small_project(tmp_path, (tip, moved[0]), (side, moved[1]))

    def search(result):
        if stopped:
            raise KeyboardInterrupt
        return (Mistake("swapped markers", "Swapping tip and side", 2e-3, 1e-4, 9, 1),)

    monkeypatch.setattr("softcal_jax.mistakes.likely_mistakes", search)
    code = main(["calibrate", str(path), "-o", str(out), "--no-pictures"])
    text = capsys.readouterr().out
    result = json.loads((out / "result.json").read_text())
    assert result["assessment"]["contradicted"]
    if stopped:
        assert code == 130
        assert result["mistakes"] == []
        assert says(result["notes"], "Interrupted")
    else:
        assert code in (0, 3)
        assert says(text, "Possible mistake: Swapping tip and side would ... values")
        assert says(result["mistakes"], "from 2 mm to 0.1 mm")
    page = (out / "report.html").read_text(encoding="utf-8")
    assert ("Possible mistake" in page) == (not stopped)


def test_a_bound_that_the_data_exclude_has_exit_code_3(tmp_path, out, capsys):
    """They were made with 300 kPa. The verdict stands once, and no number is nan."""
    path = write_small_project(tmp_path, ('upper = "1 MPa"', 'upper = "250 kPa"'))
    command = ["calibrate", str(path), "-o", str(out), "--no-pictures"]
    assert main(command) == 3
    text = "".join(capsys.readouterr())
    assert text.lower().count("do not use") == 1
    assert says(text, "Do not use these values: E ended on a bound ... data push")
    assert says(text, "Next: check the points that the verdict lists")
    assert not re.search(r"\bnan\b", text)


def stands(errors, checkpoint):
    """Whether it is said that the checkpoint is kept, and what resumes from it."""
    return says(errors, f"checkpoint {checkpoint} is kept ... same command ... --force")


def test_simulate(tmp_path, out, capsys):
    path = write_small_project(tmp_path)
    assert main(["simulate", str(path), "-o", str(out), "--no-pictures"]) == 0
    text, errors = capsys.readouterr()
    assert errors == ""
    assert "equilibrium of weight, pulled ..." in text
    assert "Time: import " in text
    lanes = json.loads((out / "simulation.json").read_text())["configurations"]
    assert [lane["name"] for lane in lanes] == ["weight", "pulled"]
    # Twice the softness of the recordings, which went down by 0.56 mm.
    assert 0.7 < -(lanes[0]["markers"][0]["simulated_mm"][2] - 10.0) < 1.0
    with (out / "markers.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["configuration"], row["marker"]) for row in rows] == [
        *(("weight", "tip"), ("weight", "side")),
        *(("pulled", "tip"), ("pulled", "side")),
    ]
    shown = [float(rows[0][f"simulated_{axis}_mm"]) for axis in "xyz"]
    np.testing.assert_allclose(shown, lanes[0]["markers"][0]["simulated_mm"], atol=1e-6)
    assert 0.25 < float(rows[0]["distance_mm"]) < 0.35


def write_values(folder, **values):
    """What of a `result.json` a prediction reads."""
    content = {
        "format": "softcal_jax.result/2",
        "converged": True,
        "source": None,
        "parameters": [{"name": k, "value": v} for k, v in values.items()],
        "configurations": [],
        "solver": {},
        "budget": {"covariance": np.eye(len(values)).tolist()},
        "assessment": {"reasons": []},
        "versions": {},
    }
    path = folder / "result.json"
    path.write_text(json.dumps(content))
    return path


CRUSHED = (
    ("(20, 0, -50) mN", "(-20000, 0, 0) N"),
    ('role = "validation"', 'role = "calibration"'),
    ("[markers]\n", "[newton]\nmax_steps = 5\n\n[markers]\n"),
)
"""A project whose second configuration has no equilibrium."""


def test_simulate_writes_what_has_an_equilibrium(tmp_path, out, capsys):
    path = write_small_project(tmp_path, *CRUSHED)
    assert main(["simulate", str(path), "-o", str(out), "--no-pictures"]) == 1
    text, errors = capsys.readouterr()
    assert says(errors, "error: no equilibrium ... 'pulled'")
    assert "'weight'" not in errors
    assert says(errors, "results contain the others")
    assert "Simulation" in text
    weight, pulled = json.loads((out / "simulation.json").read_text())["configurations"]
    assert (weight["converged"], pulled["converged"]) == (True, False)
    assert "weight.vtu" in weight["files"]
    assert (out / "weight.vtu").exists()
    assert not (out / "pulled.vtu").exists()

    values = write_values(tmp_path, E=300e3, friction=0.3)
    argv = ["simulate", str(path), "--values", str(values), "-o", str(out), "--force"]
    assert main([*argv, "--no-pictures"]) == 1
    text = capsys.readouterr().out
    assert says(text, f"values of {values}: E\n", "Prediction error of weight")
    assert "Prediction error of pulled" not in text
    pulled = json.loads((out / "simulation.json").read_text())["configurations"][1]
    assert pulled["rms_after_mm"] is None


def test_no_equilibrium_names_the_configuration(tmp_path, out, capsys):
    path = write_small_project(tmp_path, *CRUSHED)
    assert main(["calibrate", str(path), "-o", str(out)]) == 1
    errors = capsys.readouterr().err
    assert says(errors, "error: no equilibrium ... 'pulled'")
    assert "'weight'" not in errors
    assert errors.endswith("Nothing was written.\n")
    assert left_behind(tmp_path) == set()


CANDIDATES = """
[[candidates]]
name = "upside down"
gravity = "(0, 0, 9.81) m/s^2"

[[candidates]]
name = "crushed"
loads = [{ surface = "x_max", force = "(-20000, 0, 0) N" }]
"""


def test_identify(tmp_path, out, capsys):
    """Verdict and ranking without one measurement, printed and as files."""
    known = [f"{key} = 0" for key in ("density", "gravity", "clamp", "recordings")]
    exact = "\n".join(["[uncertain]", "nu = 0.0", "mesh = 0.0", *known])
    sections = f"{exact}\n\n[newton]\nmax_steps = 8\n\n[markers]\n"
    path = write_small_project(tmp_path, ("[markers]\n", sections))
    text = path.read_text()
    start, end = text.index("[shared.measured]"), text.index("[[configurations]]")
    text = text[:start] + text[end:].replace("measured.recording", "# ")
    path.write_text(text + CANDIDATES)
    assert main(["identify", str(path), "-o", str(out)]) == 0
    printed, errors = capsys.readouterr()
    assert errors == ""
    assert "what the data of weight would determine ..." in printed
    assert says(printed, "upside down, crushed, pulled, weight again ... would add")
    # Two markers on three axes; `pulled` is held out.
    assert says(printed, "Weakly identifiable", "6 measured", "1 parameter")
    assert says(printed, "tells most: expected error of E", "% ->")
    assert says(printed, "E noise", "%")  # the budget
    assert "Not ranked: 'crushed': " in printed
    assert "[[candidates]]" not in printed
    assert f"Results in {out}: open {out / 'report.html'}" in printed
    data = json.loads((out / "identifiability.json").read_text())
    assert data["identifiability"]["verdict"] == "weakly identifiable"
    assert data["source"]["project"]["sha256"] == sha256_of(path)
    assert data["settings"]["newton"]["max_steps"] == 8
    page = (out / "report.html").read_text()
    command = f"softcal identify {data['source']['project']['file']} -o repeated"
    assert command in page
    names = [c["name"] for c in data["ranking"]["candidates"]]
    assert {"upside down", "weight again", "the other end held"} <= {*names}
    assert data["budget"]["parameters"][0]["name"] == "E"
    assert [c["name"] for c in data["ranking"]["unranked"]] == ["crushed"]
    words = (out / "identifiability.txt").read_text()
    assert says(words, "small ... Weakly identifiable")
    assert words.split("\n\n")[1] in printed


def test_identify_prints_alone(tmp_path, capsys):
    """Without -o nothing is written; what might be measured is proposed."""
    path = write_small_project(tmp_path)
    assert main(["identify", str(path), "--aim", "50 %"]) == 0
    printed, errors = capsys.readouterr()
    assert errors == ""
    assert says(printed, "the other end held expected error of E")
    assert says(printed, "Nothing in reach gives 50 %")
    assert printed.split("\n")[-2].startswith("Time: import ")
    assert left_behind(tmp_path) == set()


def test_identify_names_what_has_no_equilibrium(tmp_path, out, capsys):
    path = write_small_project(tmp_path, *CRUSHED)
    assert main(["identify", str(path), "-o", str(out)]) == 1
    errors = capsys.readouterr().err
    assert says(errors, "error: no equilibrium ... 'pulled'")
    assert errors.endswith("Nothing was written.\n")
    assert left_behind(tmp_path) == set()


def test_identify_needs_something_to_judge(tmp_path, capsys):
    start = '[[parameters]]\nfield = "E"\nlower = "100 kPa"\nupper = "1 MPa"\n'
    path = write_small_project(tmp_path, (start, ""))
    assert main(["identify", str(path)]) == 2
    assert "parameters: nothing to calibrate" in capsys.readouterr().err


def test_identify_help(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["identify", "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert "No measured positions" in text
    assert "[[candidates]]" in text
    assert "exit codes: 0 assessed" in text


@pytest.mark.parametrize("command", ["calibrate", "simulate", "identify"])
def test_bad_input_leaves_nothing(tmp_path, out, capsys, command):
    path = write_small_project(tmp_path, ('E = "200 kPa"', 'E = "200 kpa"'))
    assert main([command, str(path), "-o", str(out)]) == 2
    errors = capsys.readouterr().err
    assert says(errors, f'error: {path}: material.E: "200 kpa" ... mean "kPa"')
    assert left_behind(tmp_path) == set()


def test_missing_project(tmp_path, out, capsys):
    assert main(["calibrate", str(tmp_path / "no.toml"), "-o", str(out)]) == 2
    errors = capsys.readouterr().err
    assert says(errors, f"error: ... {tmp_path / 'no.toml'} does not exist")
    assert left_behind(tmp_path) == set()


def test_nothing_to_calibrate(tmp_path, out, capsys):
    start = '[[parameters]]\nfield = "E"\nlower = "100 kPa"\nupper = "1 MPa"\n'
    path = write_small_project(tmp_path, (start, ""))
    assert main(["calibrate", str(path), "-o", str(out)]) == 2
    assert "parameters: nothing to calibrate" in capsys.readouterr().err
    assert left_behind(tmp_path) == set()


def test_warnings_are_lines(tmp_path, out, capsys, monkeypatch):
    """More parameters than data: the warning is a line, without code in it."""
    more = '[[parameters]]\nfield = "nu"\nlower = 0.1\nupper = 0.45\n\n'
    more += '[markers]\naxes = "z"\n'
    path = write_small_project(
        tmp_path,
        ("[markers]\n", more),
        ('markers = ["tip", "side"]', 'markers = ["tip"]'),
    )
    stop_at_the_first_solve(monkeypatch)
    assert main(["calibrate", str(path), "-o", str(out)]) == 130
    text = capsys.readouterr().out
    assert says(text, "warning: 2 parameters ... 1 measured")
    assert ".py" not in text


def interrupt(*args, **options):
    raise KeyboardInterrupt


def stop_at_the_first_solve(monkeypatch):
    monkeypatch.setattr(Evaluator, "from_rest", interrupt)


def test_demo_writes_its_project(tmp_path, capsys):
    folder = tmp_path / "mine"
    assert main(["demo", "--write", str(folder)]) == 0
    assert f"softcal calibrate {folder / 'project.toml'} -o" in capsys.readouterr().out
    source = ready_made_path("beam").parent
    brought = ("LICENSE-recordings.txt", "README.md", "markers.csv", "project.toml")
    assert sorted(path.name for path in folder.iterdir()) == list(brought)
    for name in brought:
        assert (folder / name).read_bytes() == (source / name).read_bytes()

    (folder / "project.toml").write_text("mine")
    assert main(["demo", "--write", str(folder)]) == 2
    assert says(capsys.readouterr().err, "project.toml exist", "--force")
    assert (folder / "project.toml").read_text() == "mine"
    assert main(["demo", "--write", str(folder), "--force"]) == 0
    assert (folder / "project.toml").read_text() != "mine"


def test_a_cost_that_is_not_finite_is_no_fit(tmp_path, out, capsys):
    """Squares of errors overflow beside so small a standard deviation."""
    change = ('[markers]\nstd = "0.1 mm"', '[markers]\nstd = "1e-300 mm"')
    path = write_small_project(tmp_path, change)
    assert main(["calibrate", str(path), "-o", str(out)]) == 2
    errors = capsys.readouterr().err
    assert says(errors, "error: ", "cost ... not finite", "1e-303", "'weight'")
    assert left_behind(tmp_path) == set()
