"""A guarded call of meshio.

On bad files meshio prints, exits the process or raises any exception. Here it either
returns a mesh or raises a `ValueError` that names the file.
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
"""Formats that `read_mesh` is tested with, and meshio's names of them."""


class MeshWarning(UserWarning):
    """A mesh file was read, but not all of its content was used."""


def read_raw(path: Path, notes: list[str]) -> meshio.Mesh:
    """Read a file with meshio.

    Args:
        path: The file.
        notes: Receives what meshio prints about it.

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
            # NumPy's warnings about old calls in the parsers do not concern the file.
            warnings.simplefilter("ignore", DeprecationWarning)
            # Without the format, meshio tries Ansys on a broken .msh and hangs.
            raw = meshio.read(path, file_format=FORMATS[suffix])
    except ModuleNotFoundError as error:
        raise ValueError(
            f"reading {path} needs the package {error.name!r}: "
            f"pip install {error.name}."
        ) from error
    # Its parsers raise exceptions of any type, and exit on some errors.
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
    """Find the lines of an Abaqus file that open a section."""
    text = path.read_text(errors="replace")
    return re.findall(rf"(?im)^\*{keyword}[ \t]*(?:,.*)?$", text)


def _check_inp(path: Path):
    """Refuse several *NODE sections, of which meshio keeps only the last."""
    sections = len(_headers(path, "NODE"))
    if sections > 1:
        raise ValueError(
            f"mesh file {path} has {sections} *NODE sections, of which the reader "
            "keeps the last; merge them into one (export a flat file, without parts)."
        )


def _mend_inp_sets(path: Path, raw: meshio.Mesh):
    """Assign the sets named in *ELEMENT lines to the cells of their own sections.

    meshio counts these sets by name, not by section, so a section without ELSET shifts
    all later ones, and a name that is used twice keeps only its last section.
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
