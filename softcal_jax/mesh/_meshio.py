"""One quiet, guarded call of meshio.

meshio prints, exits the process on some bad files and lets any exception through on
others. Here it either returns a mesh or raises a `ValueError` that names the file.
"""

import contextlib
import io
import re
import warnings
from pathlib import Path

import meshio
import numpy as np

FORMATS = {
    ".msh": "gmsh",
    ".vtu": "vtu",
    ".vtk": "vtk",
    ".inp": "abaqus",
    ".med": "med",
}
"""What `read_mesh` is tested with, and meshio's names for it."""


class MeshWarning(UserWarning):
    """A mesh file was read, but not all of it was used as it stands."""


def read_raw(path: Path, notes: list[str]) -> meshio.Mesh:
    """The file as meshio gives it.

    Args:
        path: The file.
        notes: Gains what meshio had to say about it.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the format is not read here, or the file cannot be read.
    """
    if not path.exists():
        raise FileNotFoundError(f"mesh file {path} does not exist.")
    if not path.is_file():
        raise ValueError(f"mesh file {path} is a directory.")
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise ValueError(
            f"mesh file {path} has the extension {suffix!r}; "
            f"expected one of {', '.join(FORMATS)}."
        )
    if suffix == ".inp":
        _check_inp(path)

    out, err = io.StringIO(), io.StringIO()
    try:
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            warnings.catch_warnings(),
        ):
            # NumPy's notes on the parsers' old calls say nothing about the file.
            warnings.simplefilter("ignore", DeprecationWarning)
            # By name: left to guess, meshio tries Ansys on a broken .msh and hangs.
            raw = meshio.read(path, file_format=FORMATS[suffix])
    except ModuleNotFoundError as error:
        raise ValueError(
            f"reading {path} needs the package {error.name!r}: "
            f"pip install {error.name}."
        ) from error
    # meshio lets its parsers' exceptions of any type through, and exits on others.
    except (Exception, SystemExit) as error:
        said = " ".join(f"{out.getvalue()} {err.getvalue()}".split())
        if not isinstance(error, SystemExit):
            said = f"{said} {type(error).__name__}: {error}".strip()
        raise ValueError(
            f"mesh file {path} cannot be read as {FORMATS[suffix]}; it may be "
            f"truncated or not be a mesh. The parser said: {said}"
        ) from error
    if said := " ".join(err.getvalue().split()):
        notes.append(f"meshio says: {said}")
    if suffix == ".inp":
        _mend_inp_sets(path, raw)
    return raw


def _headers(path: Path, keyword: str) -> list[str]:
    """The lines of an Abaqus file that open a section."""
    text = path.read_text(errors="replace")
    return re.findall(rf"(?im)^\*{keyword}[ \t]*(?:,.*)?$", text)


def _check_inp(path: Path):
    """Refuses what meshio reads wrongly: it keeps the last *NODE section only."""
    sections = len(_headers(path, "NODE"))
    if sections > 1:
        raise ValueError(
            f"mesh file {path} has {sections} *NODE sections, of which the reader "
            "keeps the last; merge them into one (export a flat file, without parts)."
        )


def _mend_inp_sets(path: Path, raw: meshio.Mesh):
    """Puts the sets named in *ELEMENT lines on their own cells.

    meshio numbers these sets by name, not by section, so a section without ELSET
    shifts all the later ones, and a name used twice keeps its last section only.
    """
    headers = _headers(path, "ELEMENT")
    if len(headers) != len(raw.cells):
        return  # *INCLUDE brings sections of other files, which carry no sets.
    found = [re.search(r"(?i)ELSET\s*=\s*([^,\s]+)", header) for header in headers]
    names = [match.group(1) if match else None for match in found]
    for name in {name for name in names if name}:
        raw.cell_sets[name] = [
            np.arange(len(block) if own == name else 0)
            for own, block in zip(names, raw.cells, strict=True)
        ]
