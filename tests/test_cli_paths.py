"""Commands with paths of any kind, from any folder, and with names of any kind.

What one command writes, the next one reads: results, values, meshes, tables, sweeps.
"""

import csv
import json

import pytest
from small_project import MARKERS, write_small_project
from test_cli_inverse import PUSH

from softcal_jax.cli import main

NAME = '1.5 bar/ü "q" it\'s'
"""Of a configuration, a marker and an actuator."""

PROJECT = "mein Projekt [ü].d"


@pytest.fixture(scope="module")
def top(tmp_path_factory):
    """A folder with a project in a folder, whose files and parts have such names."""
    folder = tmp_path_factory.mktemp("any path") / PROJECT
    named = json.dumps(NAME, ensure_ascii=False)
    push = PUSH.replace("actuators.push", f"actuators.{named}")
    push = push.replace('actuator = "push"', f"actuator = {named}")
    held = 'supports = [{ group = "x_min" }]\nmarkers = ["tip", "side"]\n'
    pose = f'name = {named}\nactuation = {{ {named} = "0 mN" }}\n'
    path = write_small_project(
        folder,
        ('[markers]\nstd = "0.1 mm"\n', push),
        (held, held.replace('"tip"', named) + "effectors = []\n"),
        ('name = "weight"\n', pose),
        ('tip = "(60, 10, 10) mm"', f'{named} = "(60, 10, 10) mm"'),
        ('file = "markers.csv"', 'file = "mark ers.csv"'),
    )
    path.rename(folder / "pro ject.toml")
    (folder / "markers.csv").unlink()
    cell = '"' + NAME.replace('"', '""') + '"'
    (folder / "mark ers.csv").write_text(MARKERS.replace(",tip,", f",{cell},"))
    key = json.dumps(f"configurations.{NAME}.relative_std", ensure_ascii=False)
    axes = f'[axes]\n{key} = ["0 %", "1 %"]\n'
    (folder / "swe ep.toml").write_text(f'project = "pro ject.toml"\n{axes}')
    (folder.parent / "sib ling").mkdir()
    return folder.parent


NO_NAME = "x" * 5000


@pytest.mark.parametrize(
    "words",
    [
        ("check", "p.toml", "-o", f"{NO_NAME}.png"),
        ("mesh", "p.toml", "-o", f"{NO_NAME}.msh"),
        ("tags", "-o", f"{NO_NAME}.pdf"),
        ("export", "inp", "out", "-o", f"{NO_NAME}.inp"),
        ("export", "sofa", "out", "-o", NO_NAME),
        ("demo", "--write", NO_NAME),
        ("new", NO_NAME, "--robot", "beam"),
        ("identify", "p.toml", "-o", NO_NAME),
        ("calibrate", NO_NAME, "-o", "out"),
        ("sweep", NO_NAME),
        ("sweep", "show", NO_NAME),
        ("sweep", "show", "p.toml", "--csv", NO_NAME),
        ("transfer", NO_NAME, "p.toml"),
    ],
    ids=lambda words: " ".join(words).partition(NO_NAME)[0],
)
def test_a_name_that_no_disk_takes(tmp_path, monkeypatch, capsys, words):
    """Said without a traceback, and without all of its letters."""
    monkeypatch.chdir(tmp_path)
    write_small_project(tmp_path).rename("p.toml")
    assert main([*words]) == 2
    error = capsys.readouterr().err
    assert "too long" in error
    assert len(error) < 700
    assert {path.name for path in tmp_path.iterdir()} == {"p.toml", "markers.csv"}


@pytest.fixture
def run(top, monkeypatch, capsys):
    """Runs a command in a folder below the top, and returns what it printed."""

    def run(folder, *words):
        monkeypatch.chdir(top / folder)
        code = main([str(word) for word in words])
        text, errors = capsys.readouterr()
        assert code == 0, errors
        return text

    return run


def test_from_anywhere(top, run):
    """Inside and outside the folder of the project, relative and absolute."""
    outside, there, plain = "sib ling", f"../{PROJECT}/pro ject.toml", "--no-pictures"
    text = run(PROJECT, "check", "pro ject.toml", "-o", "bild 1.svg")
    assert "Picture: bild 1.svg" in text
    run(outside, "check", there)
    assert (top / PROJECT / "pro ject_check.png").is_file()
    fit = ["-o", "../er gebnis", "--checkpoint", "fit 1.npz", plain]
    text = run(outside, "calibrate", there, *fit)
    assert "Results in ../er gebnis: open ../er gebnis/report.html" in text
    assert "step 1" not in run(outside, "calibrate", there, *fit, "--force")
    values = ["--values", "er gebnis", "-o", top / "vor wärts", plain]
    run(".", "simulate", f"{PROJECT}/pro ject.toml", *values)

    posed = ["--configuration", NAME, "--goal", f"{NAME}=(-, -, 9) mm"]
    posed += ["--limit", f"{NAME}=0 N to 1 N", "--start", f"{NAME}=0.001 N"]
    of = ["--project", "pro ject.toml", "-o", "../be fehl", plain]
    run(PROJECT, "inverse", "../er gebnis/result.json", *posed, *of)

    job = ["--configuration", "pulled", "-o", "../er gebnis/jo b.inp"]
    run(outside, "export", "inp", "../er gebnis", *job)
    mesh = ["--length-unit", "m", "-o", "net z.msh", plain, "--force"]
    for written in ("../er gebnis/jo b.inp", "../er gebnis/pulled.vtu"):
        assert "18 linear tets" in run(outside, "mesh", written, *mesh)
    groups = run(outside, "mesh", there, "-o", "ganz.msh", plain)
    mesh = ["--length-unit", "mm", "-o", "noch.msh", plain]
    listed = lambda text: [line for line in text.splitlines() if line[:2] == "  "]
    assert listed(run(outside, "mesh", "ganz.msh", *mesh)) == listed(groups)
    run(outside, "new", "ein neues", "--model", "ganz.msh", "--length-unit", "mm")
    run(outside, "demo", "--write", "be am")


def test_foam_from_anywhere(run):
    """The table that was used is one to be used, and the part one to be meshed."""
    project = f"{PROJECT}/pro ject.toml"
    run(".", "export", "icesl", project, "-o", "dru ck")
    run(".", "export", "icesl", project, "--table", "dru ck/foam.csv", "-o", "wie der")
    mesh = ["--length-unit", "mm", "--size", "20 mm", "-o", "voll.msh", "--no-pictures"]
    run("dru ck", "mesh", "robot.stl", *mesh)


def test_sweeps_from_anywhere(top, run):
    """With an axis that is a key of a configuration with a dot in its name."""
    sweep = ["sweep", f"../{PROJECT}/swe ep.toml", "--workers", "0"]
    run("sib ling", *sweep, "-o", "da ten")
    shown = ["--csv", "zei len.csv", "--plot", "bi ld.png"]
    assert "1 %" in run("sib ling", "sweep", "show", "da ten", *shown)
    lines = (top / "sib ling/zei len.csv").read_text().splitlines()
    (header, *_) = csv.reader(lines)
    assert f"configurations.{NAME}.relative_std" in header
    run(PROJECT, "sweep", "swe ep.toml", "--workers", "0", "--part", "1", "--of", "2")
    assert (top / PROJECT / "swe ep/rows-1-of-2.parquet").is_file()
