"""Fills CAD models with tets: by gmsh, or fTetWild where a surface is not clean.

Both run in processes of their own (`_program.py`), with limits on time and memory.
"""

import importlib.util
import re
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from softcal_jax._limits import MESHING_MEGABYTES, MESHING_SECONDS, TETS, LimitError
from softcal_jax._text import escaped
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.exchange.cad._surface import Triangles
from softcal_jax.mesh import SHARP

PROGRAM = Path(__file__).with_name("_program.py")
"""What fills models, in a process of its own."""

ENVELOPE = 1e-3
"""How far fTetWild may move the surface, over the diagonal of the model [-]."""

_OUT_OF_MEMORY = re.compile("MemoryError|bad_alloc|out of memory", re.IGNORECASE)
"""How programs say that they get no more memory."""

_KILLED = 9
"""SIGKILL, by which Linux ends a process when memory runs out."""


class GmshError(ValueError):
    """Gmsh does not fill a model, or its surface is open; the text is what it says."""


class Filled(NamedTuple):
    """A volume filled with linear tets, in the length unit of the model.

    `faces` are corners of the triangles on each face of the model that bounds the body,
    `solids` indices of the tets of each solid; the volume of the model is nan if
    unknown.
    """

    points: Float[HostArray, "n_nodes 3"]
    tets: Int[HostArray, "n_tets 4"]
    faces: list[Int[HostArray, "_ 3"]]
    solids: list[Int[HostArray, " _"]]
    volume: float


def fill_step(path: Path, size: float | None) -> Filled:
    """Fill the solids of a STEP file; the size and the result are in mm."""
    _check_gmsh()
    return _run("gmsh, STEP", {"path": str(path)}, size)


def fill_stl(triangles: Triangles, size: float | None) -> Filled:
    """Fill the inside of a surface by gmsh; lengths are in the unit of the file."""
    if n := triangles.n_open_edges:
        raise GmshError(f"it is not closed, {n} edges do not join two triangles.")
    _check_gmsh()
    return _run("gmsh, STL", _surface(triangles), size)


def fill_wild(triangles: Triangles, size: float | None) -> Filled:
    """Fill a surface with holes, crossings or repeated triangles, by pytetwild."""
    if importlib.util.find_spec("pytetwild") is None:
        raise ImportError("No module named 'pytetwild'", name="pytetwild")
    return _run("pytetwild", _surface(triangles), size)


def _surface(triangles: Triangles) -> dict[str, Any]:
    return {
        **triangles._asdict(),
        "volume": abs(triangles.volume),
        "sharp": SHARP,
        "envelope": ENVELOPE,
    }


def _check_gmsh() -> None:
    if importlib.util.find_spec("gmsh") is None:
        raise ImportError(
            "making a mesh of a CAD model needs gmsh: pip install 'softcal-jax[cad]'."
        )


def _run(by: str, given: dict[str, Any], size: float | None) -> Filled:
    """Fill a model in a process of its own, and read what it made."""
    limits: Any = {"most": TETS.most, "megabytes": MESHING_MEGABYTES.most}
    given = {"by": by, "size": np.nan if size is None else size, **given, **limits}
    seconds = min(MESHING_SECONDS.most, threading.TIMEOUT_MAX)
    with tempfile.TemporaryDirectory() as folder:
        given_at, made_at = Path(folder, "given.npz"), Path(folder, "made.npz")
        np.savez(given_at, **given)
        command = [sys.executable, str(PROGRAM), str(given_at), str(made_at)]
        options = {"cwd": folder, "capture_output": True, "errors": "replace"}
        try:
            done = subprocess.run(command, timeout=seconds, **options)
        except subprocess.TimeoutExpired as error:
            raise LimitError(
                f"{_name(by)} has not filled it within the limit of {seconds:g} s, as "
                "happens where a model is damaged. Export it again, take larger tets, "
                f"or raise the limit with the environment variable "
                f"{MESHING_SECONDS.variable}."
            ) from error
        if done.returncode != 0:
            raise _failure(by, done.returncode, done.stderr)
        with np.load(made_at) as file:
            made = dict(file)
    if "reason" in made:
        raise _refusal(by, made)
    named = lambda what: [made[name] for name in made if name.startswith(what)]
    faces, solids = named("face "), named("solid ")
    return Filled(made["points"], made["tets"], faces, solids, float(made["volume"]))


def _name(by: str) -> str:
    return "fTetWild" if by == "pytetwild" else "gmsh"


def _failure(by: str, code: int, stderr: str) -> ValueError:
    """Say how the process ended that was to fill a model."""
    if _OUT_OF_MEMORY.search(stderr) or code == -_KILLED:
        return _out_of_memory(by)
    said = escaped((stderr.strip().splitlines() or ["it does not say why"])[-1])
    if code < 0:
        said = f"it crashed ({signal.strsignal(-code)})"
    if by == "pytetwild":
        return ValueError(f"gmsh cannot fill this surface, and fTetWild fails: {said}.")
    # Where no memory is left, some parts of gmsh crash.
    return GmshError(
        f"gmsh fails: {said}. The file seems to be damaged, or its surfaces cross: open"
        " it in a CAD program, mend it, and export it again. If it is sound, it may "
        f"need more memory than the limit of {MESHING_MEGABYTES.most:g} MB, which the "
        f"environment variable {MESHING_MEGABYTES.variable} raises."
    )


def _out_of_memory(by: str) -> LimitError:
    return LimitError(
        f"{_name(by)} needs more memory than there is, or than the limit of "
        f"{MESHING_MEGABYTES.most:g} MB, as happens where a model is damaged. Export it"
        " again, take larger tets, or raise the limit with the environment variable "
        f"{MESHING_MEGABYTES.variable}."
    )


def _refusal(by: str, made: dict[str, Any]) -> ValueError | ImportError:
    """Return the error of a reason for which nothing was made."""
    reason, text = str(made["reason"]), escaped(str(made["text"]))
    if _OUT_OF_MEMORY.search(text):
        return _out_of_memory(by)
    if reason == "tets":
        return TETS.error(text, float(made["number"]))
    if reason == "import":
        return ImportError(
            f"gmsh is installed, but cannot be loaded ({text}). On Debian or Ubuntu: "
            "sudo apt install libgl1 libglu1-mesa libxcursor1 libxft2 libxinerama1"
        )
    if by == "pytetwild":
        return ValueError(f"gmsh cannot fill this surface, and {text}.")
    return GmshError(text) if reason == "gmsh" else ValueError(text)
