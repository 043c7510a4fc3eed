"""The command blocks of README, docs/start and docs/guide run as they are printed.

Each page has a fresh folder with the files that it names, as small as they can be. What
is run is the text of the page. `NOT_RUN` lists the few lines that are not, and why.
"""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
from small_project import write_small_project
from test_cli_design import PROJECT as DESIGN, write_poses_of_the_print

from softcal_jax.cli import main

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs/start").glob("*.md")),
    *sorted((ROOT / "docs/guide").glob("*.md")),
]

ENVIRONMENT = "makes or enters the environment, in which the tests run already"
NOT_RUN = {
    "(python3 -c 'import ensurepip' &&": "the whole line is run by .ci/run",
    ".venv/bin/softcal demo -o demo_results": "run by .ci/run, from the README",
    ".venv/bin/python -m pytest": "is what runs this",
    ".venv/bin/python -m sphinx": "run by a slow test of tests/test_docs.py",
    ". .venv/bin/activate": ENVIRONMENT,
    "python3 -m venv": ENVIRONMENT,
    ".venv/bin/pip install": ENVIRONMENT,
    "ccx job": "CalculiX is no Python package",
    "python -m mujoco.viewer": "needs a screen",
    "from dask_jobqueue import": "needs a cluster with SLURM",
}
"""How lines begin that are not run, or blocks of Python in which such a line stands."""


class Block(NamedTuple):
    """A block of a page: its language, and its text without the fence."""

    language: str
    text: str

    @property
    def left_out(self):
        """The beginnings of what is not run of it."""
        lines = self.text.splitlines()
        return [start for start in NOT_RUN for line in lines if line.startswith(start)]

    @property
    def commands(self):
        """Words of the commands that are run, with their variables filled in."""
        for line in self.text.splitlines():
            words = shlex.split(os.path.expandvars(line), comments=True)
            if words and not line.startswith(tuple(NOT_RUN)):
                assert words[0] == "softcal", f"neither run nor in NOT_RUN: {line}"
                yield words[1:]


def blocks(page):
    """The blocks of commands and of Python, and those without a language.

    A listing of the package's own source is none.
    """
    text = re.sub(r"(?ms)^<!-- source: .*?^```$", "", page.read_text("utf-8"))
    found = re.findall(r"(?ms)^```([^\n]*)$\n(.*?)^```$", text)
    run = ("sh", "bash", "", "python")
    return [Block(language, text) for language, text in found if language in run]


def shown(page, language, which=0):
    """The text of one of a page's blocks."""
    text = (ROOT / page).read_text("utf-8")
    return re.findall(rf"(?ms)^```{language}$\n(.*?)^```$", text)[which]


# A rod that hangs: its end moves by what a modulus of 300 kPa gives, in mm.
POSES = """\
pose,marker,x_mm,y_mm,z_mm
hanging,tip,2.502,2.499,-0.173
hanging,mid,2.501,4.997,49.871
weight,tip,2.502,2.499,-0.675
weight,mid,2.501,4.992,49.671
"""


def write_step(path, *sides):
    """A box as a STEP file [mm]."""
    modelled = pytest.importorskip("exchange.cad.cad_models").modelled
    with modelled(path) as shape:
        shape.addBox(0, 0, 0, *sides)


def rod(model, table):
    """Writes the files of one's own robot, as a page calls them."""

    def write(folder, number):
        if number == 0:
            write_step(folder / model, 5, 5, 100)
            (folder / table).write_text(POSES)

    return write


def nothing(folder, number):
    """For pages whose commands make all that they need."""


def small(folder, number):
    if number == 0:
        write_small_project(folder)


def calibrated(folder, number):
    """Results of the small project, and of another robot."""
    if number == 0:
        write_small_project(folder)
        write_small_project(folder / "b")
        for out in ("results", "results_of_a"):
            command = ["calibrate", "project.toml", "-o", out, "--no-pictures"]
            assert main(command) == 0


def finger(folder, number):
    """Results of the pneumatic finger, as the page says."""
    if number == 0:
        assert main(["new", "finger", "--robot", "pneumatic-finger"]) == 0
        assert main(["calibrate", "finger/project.toml", "-o", "results"]) == 0


def design(folder, number):
    """The goals of the page; then what is measured of the robot that was printed."""
    if number == 0:
        plain = DESIGN.partition("[[configurations]]")[0]
        plain = plain.replace('std = "0.3 mm"', 'std = "0.5 mm"')  # its tolerance
        settings = "\n[settings]\nstarts = 1\n"
        goals = shown("docs/guide/design.md", "toml")
        (folder / "project.toml").write_text(plain + goals + settings)
    else:
        write_poses_of_the_print(folder / "design", folder / "design")


def swept(folder, number):
    """The sweep of the page; then one that is large enough for its parts."""
    if number == 0:
        beam = (ROOT / "tests/project/anisotropic_beam.toml").read_text("utf-8")
        beam = beam.replace("cells = [10, 2, 2]", "cells = [4, 1, 1]")
        # Some draws on so coarse a mesh have a long, flat valley.
        settings = "\n[settings]\nmax_steps = 300\n"
        (folder / "project.toml").write_text(beam + settings)
        (folder / "sweep.toml").write_text(shown("docs/guide/sweeps.md", "toml"))
    elif blocks(ROOT / "docs/guide/sweeps.md")[number].language == "bash":
        write_small_project(folder)
        many = 'project = "project.toml"\n[axes]\nnoise = { count = 10000 }\n'
        (folder / "sweep.toml").write_text(many)


def drawn(folder, number):
    """The small project, and a sweep of it."""
    if number == 0:
        write_small_project(folder)
        few = 'project = "project.toml"\n[axes]\nnoise = { count = 2 }\n'
        (folder / "sweep.toml").write_text(few)
        assert main(["sweep", "sweep.toml", "--workers", "0"]) == 0


SLOW = pytest.mark.slow  # a minute each, nearly all of it compiling
SCENES = {
    "README.md": (rod("finger.step", "markers.csv"), ()),
    "docs/start/first-calibration.md": (nothing, SLOW),
    "docs/start/index.md": (nothing, ()),
    "docs/start/own-robot.md": (rod("robot.step", "poses.csv"), SLOW),
    "docs/guide/contact.md": (nothing, SLOW),
    "docs/guide/control.md": (finger, SLOW),
    "docs/guide/design.md": (design, SLOW),
    "docs/guide/differentiate.md": (nothing, SLOW),
    "docs/guide/extend.md": (nothing, SLOW),
    "docs/guide/fields.md": (nothing, SLOW),
    "docs/guide/other-programs.md": (calibrated, SLOW),
    "docs/guide/pictures.md": (drawn, SLOW),
    "docs/guide/posterior.md": (nothing, SLOW),
    "docs/guide/robots.md": (nothing, SLOW),
    "docs/guide/sweeps.md": (swept, SLOW),
    "docs/guide/verdict.md": (calibrated, SLOW),
    "docs/guide/what-to-measure.md": (small, ()),
}
"""What writes the files of each page that has such blocks, before each of them."""

BEFORE = {
    "docs/guide/contact.md": """\
import jax, softcal_jax as sc
jax.config.update("jax_enable_x64", True)
mesh, law = sc.beam(0.06, 0.03, 0.02, (3, 2, 1)), sc.NeoHookean(E=2e5, nu=0.45)
""",
    "docs/guide/control.md": shown("docs/guide/robots.md", "python"),
    "docs/guide/verdict.md": """\
import jax, softcal_jax as sc
jax.config.update("jax_enable_x64", True)
result = sc.load_project("project.toml").calibrate()
""",
}
"""What a page of Python takes from another page, or from its reader."""


def test_every_block_is_run_or_listed():
    names = [page.relative_to(ROOT).as_posix() for page in PAGES if blocks(page)]
    assert sorted(SCENES) == sorted(names)
    every = [block for page in PAGES for block in blocks(page)]
    assert {start for block in every for start in block.left_out} == {*NOT_RUN}
    asked = [words for b in every if b.language != "python" for words in b.commands]
    assert {"new", "check", "identify", "calibrate"} <= {words[0] for words in asked}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=marks) for name, (_, marks) in SCENES.items()]
)
def test_a_page_runs_as_printed(name, tmp_path, monkeypatch):
    """Every command ends with the exit code 0, and so does the program of a page."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SLURM_ARRAY_TASK_ID", "0")
    prepare, _ = SCENES[name]
    program = BEFORE.get(name, "")
    for number, block in enumerate(blocks(ROOT / name)):
        prepare(tmp_path, number)
        if block.language == "python":
            program += "" if block.left_out else f"\n{block.text}"
            continue
        for words in block.commands:
            assert main(words) == 0, words
    if any(b.language == "python" and not b.left_out for b in blocks(ROOT / name)):
        Path("program.py").write_text(program)
        subprocess.run([sys.executable, "program.py"], check=True, cwd=tmp_path)


def test_the_project_file_of_the_readme(tmp_path, monkeypatch, capsys):
    """As it stands, with the CAD model and the table that it names."""
    text = (ROOT / "README.md").read_text("utf-8").split("<!-- fragment: finger -->")[1]
    text = text.split("```toml\n")[1].split("```")[0]
    (tmp_path / "project.toml").write_text(text)
    write_step(tmp_path / "finger.step", 100, 20, 20)
    rows = "hanging,tip,99,10,5\nweight,tip,97,10,0\n"
    (tmp_path / "markers.csv").write_text(f"pose,marker,x_mm,y_mm,z_mm\n{rows}")
    monkeypatch.chdir(tmp_path)
    assert main(["check", "project.toml", "--no-pictures"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"weight +fitted .*500 mN along -z at \(100, 10, 10\) mm", said)
    assert re.search(r"softcal calibrate +ready to run", said)
