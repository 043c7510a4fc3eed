"""A guarded call of meshio, the named groups of a file, and what meshio leaves to it.

On bad files meshio prints, exits the process or raises any exception. Here it either
returns a mesh or raises a `ValueError` that names the file. The sections, sets and
*INCLUDE lines of Abaqus files are checked and mended here.
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

from softcal_jax._files import check_file
from softcal_jax._limits import MEGABYTES, LimitError
from softcal_jax._text import escaped
from softcal_jax._typing import HostArray
from softcal_jax._warnings import SoftcalWarning

FORMATS = {
    ".msh": "gmsh",
    ".vtu": "vtu",
    ".vtk": "vtk",
    ".inp": "abaqus",
    ".med": "med",
}
"""Formats that `read_mesh` is tested with, and meshio's names of them."""


class MeshWarning(SoftcalWarning):
    """A mesh file was read, but not all of its content was used."""


class ParserError(Exception):
    """A parser refuses a file; the text is its message."""


def check_inp(path: Path) -> None:
    """Raise ValueError if meshio would misread a file, or it includes what it may not.

    meshio keeps the last of several *NODE sections, and opens all that *INCLUDE names.
    """
    included = included_files(path)
    size = sum(file.stat().st_size for file in (path, *included)) / 1e6
    MEGABYTES.check(f"mesh file {path} with what it includes", size)
    if (sections := len(_headers(path, "NODE"))) > 1:
        raise ValueError(
            f"mesh file {path} has {sections} *NODE sections, of which the reader "
            "keeps the last; merge them into one (export a flat file, without parts)."
        )


def included_files(path: Path) -> list[Path]:
    """List the files that an Abaqus file includes, once each and in its folder."""
    folder, files = path.resolve().parent, [path.resolve()]
    for source in files:  # the list grows meanwhile
        for name in _named_files(source):
            file = Path(name) if Path(name).exists() else source.parent / name
            file = file.resolve()
            where = f"mesh file {source}: *INCLUDE of {name!r}"
            if not file.is_relative_to(folder):
                raise ValueError(
                    f"{where}: it lies outside the folder of the mesh, {folder}; copy "
                    "it there."
                )
            check_file(file, f"{where}:")
            if file in files:
                raise ValueError(f"{where}: it is included already; include it once.")
            files.append(file)
    return files[1:]


def _named_files(path: Path) -> list[str]:
    """Find what a file includes, in the lines that meshio takes for an *INCLUDE."""
    text = path.read_text(errors="replace")
    lines = [line for line in text.split("\n") if not line.startswith("**")]
    keyword = lambda line: line.partition(",")[0].strip().replace("*", "").upper()
    return [line.split("=")[-1].strip() for line in lines if keyword(line) == "INCLUDE"]


def _headers(path: Path, keyword: str) -> list[str]:
    """Find the lines of an Abaqus file that open a section."""
    text = path.read_text(errors="replace")
    return re.findall(rf"(?im)^\*{keyword}[ \t]*(?:,.*)?$", text)


def mend_inp_sets(path: Path, raw: meshio.Mesh) -> None:
    """Assign the sets named in *ELEMENT lines to the cells of their own sections.

    meshio counts these sets by name, not by section, so a section without ELSET shifts
    all later ones, and a name that is used twice keeps only its last section.
    """
    headers = _headers(path, "ELEMENT")
    if len(headers) != len(raw.cells):
        return  # *INCLUDE brings sections of other files, which carry no sets.
    matches = [re.search(r"(?i)ELSET\s*=\s*([^,\s]+)", header) for header in headers]
    names = [match.group(1) if match else None for match in matches]
    for name in {name for name in names if name}:
        raw.cell_sets[name] = [
            np.arange(len(block) if section == name else 0)
            for section, block in zip(names, raw.cells, strict=True)
        ]


def read_raw(path: Path, notes: list[str]) -> meshio.Mesh:
    """Read a file with meshio, and add what it prints to the notes."""
    check_file(path, "mesh file")
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise ValueError(
            f"mesh file {path} has the extension {suffix!r}; "
            f"expected one of {', '.join(FORMATS)}."
        )
    if suffix == ".inp":
        check_inp(path)

    try:
        raw, said = parse_mesh_file(path, FORMATS[suffix])
    except ModuleNotFoundError as error:
        raise ValueError(
            f"reading {path} needs a package: pip install {error.name}."
        ) from error
    except ParserError as error:
        raise ValueError(
            f"mesh file {path} cannot be read as {FORMATS[suffix]}. The parser said: "
            f"{error}"
        ) from error
    if said:
        notes.append(f"meshio says: {said}")
    if suffix == ".inp":
        mend_inp_sets(path, raw)
    return raw


def parse_mesh_file(path: Path, kind: str) -> tuple[meshio.Mesh, str]:
    """Read a file in one of meshio's formats; also return the complaints of meshio.

    Raises:
        LimitError: If it is too large unpacked.
        ModuleNotFoundError: If the format needs a package that is not installed.
        ParserError: If it cannot be read.
    """
    out, err = io.StringIO(), io.StringIO()
    try:
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            warnings.catch_warnings(),
            np.errstate(over="ignore"),  # the STL parser takes text for a number
        ):
            # NumPy's warnings about old calls in the parsers do not concern the file.
            warnings.simplefilter("ignore", DeprecationWarning)
            # A kilobyte of a compressed file can hold a megabyte of zeros, so the sizes
            # that it states are checked before anything is unpacked.
            if stated_bytes := _STATED_BYTES.get(path.suffix.lower()):
                MEGABYTES.check(f"mesh file {path}, unpacked", stated_bytes(path) / 1e6)
            # Without the format, meshio tries Ansys on a broken .msh and hangs.
            raw = meshio.read(path, file_format=kind)
    except (ModuleNotFoundError, LimitError):
        raise
    # The parsers raise exceptions of any type, and exit on some errors.
    except (Exception, SystemExit) as error:
        said = " ".join(f"{out.getvalue()} {err.getvalue()}".split())
        if not isinstance(error, SystemExit):
            said = f"{said} {type(error).__name__}: {error}".strip()
        raise ParserError(escaped(said)) from error
    return raw, " ".join(err.getvalue().split())


_KINDS = ("point", "line", "surface", "volume")


class RawGroups(NamedTuple):
    """The groups of a file: by name, their cells in each block, and their points."""

    cells: dict[str, dict[int, HostArray]]
    points: dict[str, HostArray]


def raw_groups(raw: meshio.Mesh) -> RawGroups:
    """Collect sets, Gmsh's physical groups and MED's families by name."""
    cells: dict[str, dict[int, HostArray]] = {}
    for name, block, members in _cell_members(raw):
        blocks = cells.setdefault(escaped(name), {})
        if np.size(members):
            members = np.asarray(members, dtype=int)
            blocks[block] = np.union1d(blocks.get(block, members), members)
    sets = raw.point_sets.items()
    points = {escaped(name): np.asarray(p, int) for name, p in sets}
    for tag, names in getattr(raw, "point_tags", {}).items():
        members = np.flatnonzero(raw.point_data["point_tags"] == tag)
        for name in map(escaped, names):
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


def _vtu_bytes(path: Path) -> int:
    """Add up the arrays of a VTK file from the attributes of its tags."""
    tags = path.read_text(errors="replace").partition("<AppendedData")[0]
    total, n_rows = 0, 0
    rows_of: dict[str, int] = {}
    for tag, text in re.findall(r"<(\w+)([^>]*)", tags):
        attributes = re.findall(r'(\w+)\s*=\s*"[A-Za-z]*(\d{1,18})"', text)
        numbers = {name: int(digits) for name, digits in attributes}
        if tag == "Piece":
            n_points = numbers.get("NumberOfPoints", 0)
            n_cells = numbers.get("NumberOfCells", 0)
            rows_of = dict.fromkeys(("Points", "PointData"), n_points)
            rows_of |= dict.fromkeys(("Cells", "CellData"), n_cells)
        n_rows = rows_of.get(tag, n_rows)
        if tag == "DataArray":
            # The type, like "Float64", ends in the number of bits.
            n_bytes = numbers.get("type", 64) // 8
            total += n_rows * numbers.get("NumberOfComponents", 1) * n_bytes
    return total


def _hdf5_bytes(path: Path) -> int:
    """Add up the datasets of an HDF5 file."""
    import h5py

    sizes = []
    with h5py.File(path) as file:
        file.visititems(lambda _, part: sizes.append(getattr(part, "nbytes", 0)))
    return sum(sizes)


_STATED_BYTES = {".vtu": _vtu_bytes, ".med": _hdf5_bytes}
