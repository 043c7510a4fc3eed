"""A guarded call of meshio, and the named groups of a file.

On bad files meshio prints, exits the process or raises any exception. Here it either
returns a mesh or raises a `ValueError` that names the file.
"""

import contextlib
import io
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import meshio
import numpy as np

from softcal_jax._typing import HostArray

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
    """Read a file with meshio, and add what it prints to the notes."""
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
    if suffix == ".inp" and (sections := len(_headers(path, "NODE"))) > 1:
        raise ValueError(
            f"mesh file {path} has {sections} *NODE sections, of which the reader "
            "keeps the last; merge them into one (export a flat file, without parts)."
        )

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


_KINDS = ("point", "line", "surface", "volume")


class RawGroups(NamedTuple):
    """The groups of a file: by name, their cells in each block, and their points."""

    cells: dict[str, dict[int, HostArray]]
    points: dict[str, HostArray]


def raw_groups(raw: meshio.Mesh) -> RawGroups:
    """Collect sets, Gmsh's physical groups and MED's families by name."""
    cells: dict[str, dict[int, HostArray]] = {}
    for name, block, members in _cell_members(raw):
        own = cells.setdefault(name, {})
        if np.size(members):
            members = np.asarray(members, dtype=int)
            own[block] = np.union1d(own.get(block, members), members)
    points = {name: np.asarray(p, int) for name, p in raw.point_sets.items()}
    for tag, names in getattr(raw, "point_tags", {}).items():
        members = np.flatnonzero(raw.point_data["point_tags"] == tag)
        for name in names:
            points[name] = np.union1d(points.get(name, members), members)
    return RawGroups(cells, points)


def _cell_members(raw: meshio.Mesh) -> Iterator[tuple[str, int, Any]]:
    """Yield the name of a group, a block, and the cells of the block in the group."""
    for name, blocks in raw.cell_sets.items():
        if not name.startswith("gmsh:"):
            for block, members in enumerate(blocks):
                yield name, block, [] if members is None else members
    named = {
        (int(entry[0]), int(entry[1])): name
        for name, entry in raw.field_data.items()
        if np.size(entry) == 2 and np.asarray(entry).dtype.kind in "iu"
    }
    for block, tags in enumerate(raw.cell_data.get("gmsh:physical", [])):
        tags, dim = np.asarray(tags), raw.cells[block].dim
        for tag in np.unique(tags[tags > 0]):
            # A tag without a name becomes e.g. "surface_7".
            name = named.get((int(tag), dim), f"{_KINDS[dim]}_{tag}")
            yield name, block, np.flatnonzero(tags == tag)
    # meshio keeps MED's families as attributes that other formats lack.
    for tag, names in getattr(raw, "cell_tags", {}).items():
        for block, tags in enumerate(raw.cell_data.get("cell_tags", [])):
            for name in names:
                yield name, block, np.flatnonzero(tags == tag)
