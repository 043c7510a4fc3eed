"""The command line where nothing can be written, or it is stopped before that."""

import errno
import json
import os
import tempfile

import pytest
from small_project import write_small_project
from test_cli import interrupt, left_behind, stands, stop_at_the_first_solve
from wording import says

from softcal_jax.cli import main


def test_interrupted_before_the_first_step(tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    stop_at_the_first_solve(monkeypatch)
    path = write_small_project(tmp_path)
    assert main(["calibrate", str(path), "-o", str(out)]) == 130
    assert capsys.readouterr().err == "interrupted; nothing was written.\n"
    assert left_behind(tmp_path) == set()
    # Of a command that was stopped later, before this one.
    checkpoint = tmp_path / "fit.npz"
    checkpoint.write_bytes(b"")
    monkeypatch.setattr("softcal_jax.project.Project.calibrate", interrupt)
    command = ["calibrate", str(path), "-o", str(out), "--checkpoint", str(checkpoint)]
    assert main(command) == 130
    errors = capsys.readouterr().err
    assert errors.startswith("interrupted. ")
    assert stands(errors, checkpoint)


@pytest.mark.parametrize("command", ["calibrate", "simulate", "identify"])
@pytest.mark.parametrize("place", ["project.toml/out", "n" * 300])
def test_an_unwritable_folder_is_found_before_anything_is_solved(
    tmp_path, capsys, monkeypatch, command, place
):
    """Even before the project is read."""
    monkeypatch.setattr("softcal_jax.project.load_project", interrupt)
    path = write_small_project(tmp_path)
    assert main([command, str(path), "-o", str(tmp_path / place)]) == 2
    errors = capsys.readouterr().err
    assert says(errors, f"error: ... {tmp_path / place[:60]}")  # long names are cut
    assert errors.endswith("choose another folder.\n")
    assert left_behind(tmp_path) == set()


@pytest.mark.parametrize(
    "also_there", [pytest.param(True, marks=pytest.mark.slow), False]
)
def test_on_a_full_disk_the_fit_is_printed_and_written_elsewhere(
    tmp_path, capsys, monkeypatch, also_there
):
    from softcal_jax.results import _write

    really, second = _write.write_json, tmp_path / "second"
    out = tmp_path / "out"
    second.mkdir()

    def full(path, data):
        if path.is_relative_to(second) and also_there:
            return really(path, data)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr(_write, "write_json", full)
    monkeypatch.setattr(tempfile, "tempdir", str(second))
    path = write_small_project(tmp_path)
    checkpoint = tmp_path / "fit.npz"
    command = ["calibrate", str(path), "-o", str(out), "--checkpoint", str(checkpoint)]
    command.append("--no-pictures")
    assert main(command) == 2
    text, errors = capsys.readouterr()
    assert "300.0" in text  # E of the recordings [kPa]
    first, then = errors.splitlines()
    assert says(first, "error: ", f"{out} (No space left", "another folder")
    assert stands(then, checkpoint)
    assert left_behind(tmp_path) == {"second", "fit.npz"}
    if also_there:
        (folder,) = second.iterdir()
        assert says(then, f"All results are in {folder}")
        assert json.loads((folder / "result.json").read_text())["converged"]
    else:
        assert says(then, f"not be written elsewhere ... {second}")
        assert not [path for path in second.rglob("*") if path.is_file()]
        monkeypatch.undo()
        assert main(command) == 0
        assert "step 1" not in capsys.readouterr().out  # nothing is fitted again


FILES = {
    "project file": ["check", "HERE"],
    "project file of a fit": ["calibrate", "HERE", "-o", "out"],
    "picture": ["check", "project.toml", "-o", "HERE.png"],
    "checkpoint": ["calibrate", "project.toml", "-o", "out", "--checkpoint", "HERE"],
    "model": ["mesh", "HERE", "-o", "out.msh"],
    "mesh file": ["new", "out", "--model", "HERE"],
    "job": ["export", "inp", "results", "-o", "HERE", "--force"],
    "sweep file": ["sweep", "HERE"],
    "plot": ["sweep", "show", "swept", "--plot", "HERE"],
    "table": ["sweep", "show", "swept", "--csv", "HERE"],
    "sheet": ["tags", "-o", "HERE", "--force"],
    "foam": ["export", "icesl", "project.toml", "-o", "out", "--table", "HERE"],
}


@pytest.mark.parametrize("what", FILES)
@pytest.mark.parametrize("place", [".", "", "/"])
def test_a_directory_is_no_file(tmp_path, capsys, monkeypatch, what, place):
    """Said alike by all commands, before anything is written."""
    write_small_project(tmp_path)
    (tmp_path / "sweep.toml").write_text('project = "project.toml"\n[axes]\nstart=[0]')
    (tmp_path / "a.png").mkdir()
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.chdir(tmp_path)
    words = [place if word == "HERE" else word for word in FILES[what]]
    assert main([{"HERE.png": "a.png"}.get(word, word) for word in words]) == 2
    errors = capsys.readouterr().err
    shown = "a.png" if what == "picture" else place or "."
    assert says(errors, f"{shown} is a directory; name ... file in it.")
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("what", ["picture", "checkpoint", "job", "sweep", "sheet"])
def test_a_file_needs_a_folder(tmp_path, capsys, monkeypatch, what):
    write_small_project(tmp_path)
    (tmp_path / "sweep.toml").write_text('project = "project.toml"\n[axes]\nstart=[0]')
    monkeypatch.chdir(tmp_path)
    given = {**FILES, "sweep": ["sweep", "sweep.toml", "-o", "HERE"]}[what]
    words = [word.replace("HERE", "none/a") for word in given]
    assert main(words) == 2
    assert says(capsys.readouterr().err, "folder none of", "does not exist: make it")
