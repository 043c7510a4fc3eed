"""Sweep files: what they say, and what is wrong with them."""

from pathlib import Path

import numpy as np
import pytest
from anisotropic_project import write_anisotropic_project
from small_project import write_small_project

from softcal_jax.project import ProjectError, load_project
from softcal_jax.sweeps import _calibration, load_sweep

HEAD = 'project = "project.toml"\n'

TRUTH = """
[truth]
"E_t of CP 1" = "900 kPa"
"E_t of CP 2" = "600 kPa"
"E_l of CP 1" = "300 kPa"
"E_l of CP 2" = "200 kPa"
"theta of CP 1" = "20 deg"
"theta of CP 2" = "-35 deg"
"""


def write(folder, text):
    path = folder / "sweep.toml"
    path.write_text(HEAD + text)
    return path


@pytest.fixture
def small(tmp_path):
    """A folder with a measured project."""
    write_small_project(tmp_path)
    return tmp_path


@pytest.fixture
def beam(tmp_path):
    """A folder with a project of control points, of which nothing is measured."""
    write_anisotropic_project(tmp_path)
    return tmp_path


def test_axes_of_the_project_and_of_the_data(small):
    path = write(
        small,
        """
seed = 3
[axes]
noise = { count = 2 }
start = [0, 4]
"material.nu" = [0.2, 0.3]
configurations = { choose = 1 }
""",
    )
    sweep = load_sweep(path)
    assert len(sweep.points) == 8
    # Trials of one shape stand next to one another, repetitions change first.
    assert sweep.points[0] == {
        "material.nu": 0.2, "configurations": ["weight"], "start": 0, "noise": 1,
    }  # fmt: skip
    assert sweep.points[1]["noise"] == 2
    assert [p["material.nu"] for p in sweep.points] == [0.2] * 4 + [0.3] * 4
    assert sweep.folder == small / "sweep"
    assert set(sweep.definitions) == {
        "content of project.toml", "content of markers.csv", "truth",
    }  # fmt: skip
    changed = sweep.function.variant(sweep.points[-1])
    assert float(changed.model.law.nu) == 0.3


def test_a_worker_forgets_before_it_has_too_many_programs(small, monkeypatch):
    """Variants of one shape share programs; they go only when maps run out."""
    path = write(small, '[axes]\n"material.nu" = [0.1, 0.2, 0.3, 0.31, 0.32]\n')
    monkeypatch.setattr(_calibration, "KEPT", 2)
    forgotten = []
    monkeypatch.setattr(_calibration.jax, "clear_caches", lambda: forgotten.append(1))
    sweep = load_sweep(path)
    assert len(_calibration._KEPT) <= 2
    assert forgotten == []
    monkeypatch.setattr(_calibration, "MOST_MAPS", 10)
    monkeypatch.setattr(_calibration, "_KEPT", {})
    sweep.function.variant(sweep.points[0])
    assert forgotten == [1]


def test_a_comment_changes_no_definition_but_a_value_does(small):
    path = write(small, "[axes]\nnoise = { count = 2 }\n")
    first = load_sweep(path).definitions
    project = small / "project.toml"
    project.write_text("# a comment\n" + project.read_text())
    assert load_sweep(path).definitions == first
    project.write_text(project.read_text().replace("nu = 0.3", "nu = 0.31"))
    assert load_sweep(path).definitions != first


def test_layouts_take_the_place_of_control_points(beam):
    path = write(
        beam,
        """
[axes]
layout = ["as in the file", "middle", "placed"]

[layouts."as in the file"]
[layouts.middle]
positions = { m = "(75, 7.5, 7.5) mm" }
power = 3
[layouts.placed]
place = 3
"""
        + TRUTH,
    )
    # The project gives CP 2 a start of its own, which only its own layout has.
    with pytest.raises(ProjectError, match=r"layout = middle: .*start: .*CP 2"):
        load_sweep(path)
    project = beam / "project.toml"
    text = project.read_text().replace('start = { "CP 2" = "0.6 MPa" }\n', "")
    project.write_text(text)
    sweep = load_sweep(path)
    names = [sweep.function.variant(point).space.names for point in sweep.points]
    assert [len(n) for n in names] == [6, 3, 9]
    assert names[1] == ["E_t of m", "E_l of m", "theta of m"]
    middle = sweep.function.variant({"layout": "middle"}).space.entries[0]
    assert middle.control_points.power == 3.0
    placed = sweep.function.variant({"layout": "placed"}).space.entries[0]
    # Spread out over the beam: the ends, then the middle.
    x = np.asarray(placed.control_points.positions)[:, 0]
    assert x.max() > 0.12
    assert x.min() < 0.03


def test_sample_of_ranges(small):
    path = write(
        small,
        """
sample = 6
[axes]
"material.E" = { low = "100 kPa", high = "400 kPa", scale = "log" }
"material.nu" = { low = 0.1, high = 0.4 }
""",
    )
    sweep = load_sweep(path)
    assert len(sweep.points) == 6
    first = sweep.points[0]
    assert first["material.E"].endswith(" kPa")
    E = float(first["material.E"].removesuffix(" kPa"))
    assert 100.0 <= E <= 400.0
    changed = sweep.function.variant(first)
    assert float(changed.model.law.nu) == first["material.nu"]
    # The start of E is the constant of the material.
    np.testing.assert_allclose(changed.parameters[0].start, 1e3 * E, rtol=1e-9)
    assert [*load_sweep(path).points] == [*sweep.points]


BAD = {
    "[axes]\nnoisee = { count = 2 }": (
        'axes.noisee: .* mean "noise".* layout, configurations, start, noise, '
        '.*"material.nu"'
    ),
    "[axes]\nnoise = []": r"axes.noise: got \[\]; expected",
    "[axes]": "axes: .*none.* layout, configurations",
    "": r"axes: missing.* \[axes\]",
    "[axes]\nnoise = 20": r"axes.noise: got 20; .*\{ count = 20 \}",
    "[axes]\nnoise = [-1]": r"axes.noise: got \[-1\]; .* 0 for none",
    "[axes]\nnoise = { count = 0 }": r"axes.noise: got .*0.*\{ count = 20 \}",
    "[axes]\nnoise = { draws = 2 }": r"axes.noise: .*draws.*\{ count = 20 \}",
    "smaple = 3\n[axes]\nnoise = [1]": (
        'smaple: .* mean "sample".* project, axes, name'
    ),
    "sample = 0\n[axes]\nnoise = [1]": "sample: got 0; .*at least 1",
    "sample = 3\n[axes]\nnoise = [1]": "1 different points.* 3",
    '[axes]\n"material.nuu" = [0.3]': (
        r'axes.material.nuu = 0.3: .*material.nuu: .* mean "nu"'
    ),
    '[axes]\n"material.nu" = [0.3, 0.7]': r"axes.material.nu = 0.7: .*nu must lie in",
    '[axes]\n"parameters.G.lower" = ["1 kPa"]': (
        r"parameters.G.lower: .* 'G'. Known: E"
    ),
    '[axes]\n"material.nu" = { low = 0.1, high = 0.4 }': (
        "axis 'material.nu' .*range.* sample = 100"
    ),
    'sample = 2\n[axes]\n"material.E" = { low = "1 kPa", high = 3 }': (
        "axes.material.E: got 1 kPa and 3"
    ),
    '[axes]\nconfigurations = ["weight"]': r"axes.configurations: got .*weight.* \[",
    '[axes]\nconfigurations = [["wieght"]]': (
        "calibration 'wieght'.* mean 'weight'.* Known: 'weight'"
    ),
    "[axes]\nconfigurations = { choose = 2 }": "choose = 2, .* 1 config.*: weight",
    '[axes]\n"material.nu" = [1979-05-27]': (r"axes.material.nu\[1\]: got 1979-05-27"),
    "[axes]\nnoise = { count = 1_000_000_000_000 }": (
        r"axes.noise: count = 1000000000000: 1e\+12 trials, .* 10 000 000\..* "
        r"SOFTCAL_MAX_PLANNED"
    ),
    "[axes]\nnoise = { count = 10_000 }\nstart = { count = 10_000 }": (
        r"axes: .*`sample`.* 100 000 000 trials, .* 10 000 000\."
    ),
    'sample = 1_000_000_000_000\n[axes]\n"material.nu" = { low = 0.1, high = 0.3 }': (
        r"axes: a sample of 1000000000000: 1e\+12 trials, .*limit"
    ),
    '[axes]\nlayout = ["ends"]': "unknown layout 'ends'.* none",
    "[axes]\nnoise = [1]\n[layouts.ends]\n": "layouts: .*axis `layout`",
    '[axes]\nlayout = ["ends"]\n[layouts.ends]\n': "replaces: got ''.* none",
    '[axes]\nnoise = [1]\n[truth]\nG = "1 kPa"': "truth: .* 'G'.* Known: 'E'",
    '[axes]\nnoise = [1]\n[truth]\nE = "1 kg"': 'truth: "1 kg": .* pressure',
}


@pytest.mark.parametrize("text", BAD, ids=lambda text: text.replace("\n", " "))
def test_bad_sweep_files(text, small):
    path = write(small, text)
    with pytest.raises(ProjectError, match=BAD[text]) as caught:
        load_sweep(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '[axes]\nlayout = ["endz"]\n[layouts.ends]\n',
            "axes.layout: .* 'endz'.* mean 'ends'",
        ),
        (
            'replaces = "end"\n[axes]\nlayout = ["a"]\n[layouts.a]\n',
            'replaces: got .end.; .*control points.* mean "ends"',
        ),
        (
            '[axes]\nlayout = ["a"]\n[layouts.a]\npositions = [[1, 2, 3]]\n',
            r"axes.layout = a: .*control_points.ends.positions",
        ),
        (
            "[axes]\nnoise = [1]\n" + TRUTH.replace('"theta of CP 2" = "-35 deg"', ""),
            "truth: .* theta of CP 2",
        ),
    ],
)
def test_bad_layouts_and_truth(text, message, beam):
    text = text if "truth" in text else text + TRUTH
    with pytest.raises(ProjectError, match=message):
        load_sweep(write(beam, text))


def test_files_that_do_not_exist(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"sweep file .*none\.toml"):
        load_sweep(tmp_path / "none.toml")
    path = write(tmp_path, "[axes]\nnoise = [1]\n")
    with pytest.raises(FileNotFoundError, match=r"project: .*no file .*/project"):
        load_sweep(path)


def test_a_project_file_with_a_similar_name_is_proposed(tmp_path):
    path = write(tmp_path, "[axes]\nnoise = [1]\n")
    (tmp_path / "projects.toml").touch()
    with pytest.raises(FileNotFoundError, match=r"mean 'projects\.toml'"):
        load_sweep(path)


def test_nothing_measured(beam):
    path = write(beam, "[axes]\nnoise = [1]\n")
    with pytest.raises(ProjectError, match=r"configurations\..* no `measured`"):
        load_sweep(path)


def test_changes_of_a_project(small):
    """Keys of tables and of named entries; None takes one out."""
    changes = {
        "parameters.E.lower": "150 kPa",
        "settings.tol": 1e-4,
        "newton": None,
        "configurations.pulled.role": "calibration",
    }
    project = load_project(small / "project.toml", changes=changes)
    assert float(project.parameters[0].lower) == 150e3
    assert project.settings.tol == 1e-4
    assert [c.name for c in project.calibration] == ["weight", "pulled"]
    with pytest.raises(ProjectError, match=r"material\.nu\.x: .*nu is no table"):
        load_project(small / "project.toml", changes={"material.nu.x": 1})


def test_the_file_in_the_docs(tmp_path):
    """What a reader copies is right, on the project that the page points to."""
    root = Path(__file__).parents[2]
    project = (root / "tests/project/anisotropic_beam.toml").read_text()
    coarse = project.replace("cells = [10, 2, 2]", "cells = [4, 1, 1]")
    (tmp_path / "project.toml").write_text(coarse)
    page = (root / "docs/guide/sweeps.md").read_text()
    text = page.split("<!-- file: sweep.toml -->")[1]
    path = tmp_path / "sweep.toml"
    path.write_text(text.split("```toml\n")[1].split("```")[0])
    sweep = load_sweep(path)
    assert len(sweep.points) == 2 * 2 * 2 * 3 * 5
    # The range that it shows in a comment.
    shown = path.read_text().replace("# sample", "sample").replace('# "mat', '"mat')
    path.write_text(shown)
    assert len(load_sweep(path).points) == 100
