"""Fills CAD models with tets: by gmsh, or fTetWild where a surface is not clean.

Both run in processes of their own (`_program.py`), with limits on time and memory.
"""

import importlib.util
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any, NamedTuple

from softcal_jax._limits import (
    MESHING_MEGABYTES,
    MESHING_SECONDS,
    TETS,
    Limit,
    LimitError,
)
from softcal_jax._text import escaped
from softcal_jax._typing import Float, HostArray, Int

PROGRAM = Path(__file__).with_name("_program.py")
"""What fills models, in a process of its own."""

_OUT_OF_MEMORY = re.compile("MemoryError|bad_alloc|alloc failed|out of memory", re.I)
"""How programs say that they get no more memory."""


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


def fill(by: str, given: dict[str, Any], size: float | None) -> Filled:
    """Fill a model by "gmsh, STEP", "gmsh, STL" or "pytetwild", as `_program` says.

    The size is in the unit of the model, that of a STEP file mm.
    """
    package = by.split(",")[0]
    if importlib.util.find_spec(package) is None:
        raise ImportError(
            f"making a mesh of a CAD model needs {package}: pip install "
            "'softcal-jax[cad]'."
        )
    limits = {"most": TETS.most, "megabytes": MESHING_MEGABYTES.most}
    given = {"by": by, "size": size, **given, **limits}
    with tempfile.TemporaryDirectory() as folder:
        given_at, made_at = Path(folder, "given"), Path(folder, "made")
        given_at.write_bytes(pickle.dumps(given))
        command = [sys.executable, str(PROGRAM), str(given_at), str(made_at)]
        options = {"cwd": folder, "capture_output": True, "errors": "replace"}
        seconds = min(MESHING_SECONDS.most, threading.TIMEOUT_MAX)
        try:
            done = subprocess.run(command, timeout=seconds, **options)
        except subprocess.TimeoutExpired as error:
            what = f"{_name(by)} has not filled it within"
            raise _at_limit(what, MESHING_SECONDS) from error
        if done.returncode != 0:
            raise _failure(by, done.returncode, done.stderr)
        made = pickle.loads(made_at.read_bytes())
    if "reason" in made:
        raise _refusal(by, **made)
    return Filled(**made)


def _name(by: str) -> str:
    return "fTetWild" if by == "pytetwild" else "gmsh"


def _at_limit(what: str, limit: Limit) -> LimitError:
    return LimitError(
        f"{what} the limit of {limit.most:g} {limit.unit}, as happens where a model is "
        "damaged. Export it again, take larger tets, or raise the limit with the "
        f"environment variable {limit.variable}."
    )


def _out_of_memory(by: str) -> LimitError:
    what = f"{_name(by)} needs more memory than there is, or than"
    return _at_limit(what, MESHING_MEGABYTES)


def _failure(by: str, code: int, stderr: str) -> ValueError:
    """Say how the process ended that was to fill a model."""
    # By SIGKILL Linux ends a process when memory runs out.
    if _OUT_OF_MEMORY.search(stderr) or code == -9:
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


def _refusal(
    by: str, reason: str, text: str, number: float
) -> ValueError | ImportError:
    """Return the error of a reason for which nothing was made."""
    text = escaped(text)
    if _OUT_OF_MEMORY.search(text):
        return _out_of_memory(by)
    if reason == "tets":
        return TETS.error(text, number)
    if reason == "import":
        return ImportError(
            f"gmsh is installed, but cannot be loaded ({text}). On Debian or Ubuntu: "
            "sudo apt install libgl1 libglu1-mesa libxcursor1 libxft2 libxinerama1"
        )
    if by == "pytetwild":
        return ValueError(f"gmsh cannot fill this surface, and {text}.")
    return GmshError(text) if reason == "gmsh" else ValueError(text)
