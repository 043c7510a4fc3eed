import json
import os
import subprocess
import sys

import pytest
from small_project import write_small_project
from wording import says

from softcal_jax.plotting import RenderingError, _scene, rendering_problem
from softcal_jax.plotting._scene import offscreen

CHOICE = "VTK_DEFAULT_OPENGL_WINDOW"

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="elsewhere VTK draws by itself"
)


@pytest.fixture
def machine(monkeypatch):
    """A machine with the given libraries, and EGL that works or does not."""

    def make(*libraries, egl=True):
        for variable in (CHOICE, "DISPLAY"):
            monkeypatch.delenv(variable, raising=False)
        _scene._headless_backend.cache_clear()
        monkeypatch.setattr(_scene, "_can_load", lambda name: name in libraries)
        monkeypatch.setattr(_scene, "_egl_works", lambda: egl)

    yield make
    _scene._headless_backend.cache_clear()


def test_no_opengl_is_an_error_and_not_a_crash(machine):
    machine()
    problem = "no OpenGL ... sudo apt install libegl1 libgl1-mesa-dri"
    assert says(rendering_problem(), problem)
    with pytest.raises(RenderingError, match="cannot be drawn"), offscreen():
        pass


def test_egl_without_a_driver_does_not_count(machine):
    machine("libEGL.so.1", egl=False)
    assert rendering_problem() is not None


@pytest.mark.parametrize(
    ("libraries", "egl", "window"),
    [
        (("libEGL.so.1", "libOSMesa.so.8"), True, "vtkEGLRenderWindow"),
        (("libEGL.so.1", "libOSMesa.so.8"), False, "vtkOSOpenGLRenderWindow"),
        (("libOSMesa.so.6",), True, "vtkOSOpenGLRenderWindow"),
    ],
)
def test_vtk_is_told_what_to_take_only_while_it_draws(machine, libraries, egl, window):
    machine(*libraries, egl=egl)
    assert rendering_problem() is None
    with offscreen():
        assert os.environ[CHOICE] == window
    assert CHOICE not in os.environ


def test_gmsh_is_no_program_with_windows(machine):
    """It loads the library of GLX, and without a display that is all."""
    try:
        import gmsh
    except (ImportError, OSError) as error:
        pytest.skip(f"needs gmsh: {error}")
    assert gmsh.GMSH_API_VERSION
    machine("libEGL.so.1")
    with offscreen():
        assert os.environ[CHOICE] == "vtkEGLRenderWindow"


def test_the_users_choice_stands(machine, monkeypatch):
    machine()
    monkeypatch.setenv(CHOICE, "vtkXOpenGLRenderWindow")
    assert rendering_problem() is None
    with offscreen():
        assert os.environ[CHOICE] == "vtkXOpenGLRenderWindow"
    assert os.environ[CHOICE] == "vtkXOpenGLRenderWindow"


def test_a_missing_library_cannot_be_loaded():
    assert not _scene._can_load("libNoSuchThing.so.1")
    assert _scene._can_load("libc.so.6")


@pytest.fixture
def without_opengl(tmp_path):
    """The environment of a process that finds no library of OpenGL.

    The linker stops at the first file of that name, though nothing is in it.
    """
    empty = tmp_path / "no_opengl"
    empty.mkdir()
    for name in ("EGL.so.1", "OSMesa.so.8", "OSMesa.so.6", "OSMesa.so"):
        (empty / f"lib{name}").touch()
    kept = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    return {**kept, "LD_LIBRARY_PATH": str(empty)}


def test_a_command_names_the_pictures_that_it_leaves_out(tmp_path, without_opengl):
    """And what to install, in one line; nothing else is missing."""
    project, out = write_small_project(tmp_path), tmp_path / "out"
    done = subprocess.run(
        [sys.executable, "-m", "softcal_jax", "simulate", project, "-o", out],
        capture_output=True,
        text=True,
        env=without_opengl,
    )
    assert (done.returncode, done.stderr) == (0, "")
    written = json.loads((out / "simulation.json").read_text())
    (note,) = written["notes"]
    assert says(note, "weight.png, pulled.png", "no OpenGL", "sudo apt install libegl1")
    assert f"warning: {note}" in done.stdout.splitlines()
    assert {"weight.vtu", "pulled.vtu", "report.html"} <= set(written["files"])
    assert not [name for name in written["files"] if name.endswith(".png")]
