"""What a mesh file holds, as the library of its format reads it, and its groups.

Libraries read in a process of their own (`_program.py`), and either return a mesh or
raise a `ValueError` that names the file; Abaqus files are read here.
"""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import meshio
import numpy as np

from softcal_jax._apart import run_apart
from softcal_jax._files import check_file
from softcal_jax._limits import MESHING_MEGABYTES, MESHING_SECONDS, LimitError
from softcal_jax._text import escaped
from softcal_jax._typing import HostArray
from softcal_jax._warnings import SoftcalWarning
from softcal_jax.mesh._inp import read_inp

FORMATS = (".msh", ".vtu", ".vtk", ".inp", ".med")
"""Extensions of files that `read_mesh` reads."""


class MeshWarning(SoftcalWarning):
    """A mesh file was read, but not all of its content was used."""


@lru_cache(maxsize=4)  # sweeps and notebooks read a mesh again and again
def _by_library(suffix: str, content: bytes) -> tuple[meshio.Mesh, str]:
    program, given = Path(__file__).with_name("_program.py"), (suffix, content)
    limits = {"seconds": MESHING_SECONDS.most, "megabytes": MESHING_MEGABYTES.most}
    return run_apart(program, given, **limits)


def read_raw(path: Path, notes: list[str]) -> meshio.Mesh:
    """Read a file, and add what its library complains of to the notes."""
    check_file(path, "mesh file")
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise ValueError(
            f"mesh file {path} has the extension {suffix!r}; "
            f"expected one of {', '.join(FORMATS)}."
        )
    try:
        if suffix == ".inp":
            return read_inp(path)
        raw, said = _by_library(suffix, path.read_bytes())
    except LimitError:
        raise
    except (ValueError, RuntimeError, MemoryError, TimeoutError) as error:
        what = f"mesh file {path} cannot be read as {suffix}"
        raise ValueError(f"{what}: {escaped(str(error))}") from error
    if said:
        notes.append(f"its reader says: {escaped(' '.join(said.split()))}")
    return raw


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
