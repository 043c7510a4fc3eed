"""Named groups of a mesh file, however its format stores them."""

from typing import NamedTuple

import meshio
import numpy as np

from softcal_jax._typing import HostArray

_KINDS = ("point", "line", "surface", "volume")

CellGroups = dict[str, dict[int, HostArray]]
"""Per group: per cell block, the cells that belong to it."""


class RawGroups(NamedTuple):
    """The groups of a file: cells by block, and points."""

    cells: CellGroups
    points: dict[str, HostArray]


def raw_groups(raw: meshio.Mesh) -> RawGroups:
    """Collect sets, Gmsh's physical groups and MED's families by name."""
    cells: CellGroups = {}
    _add_sets(raw, cells)
    _add_physical(raw, cells)
    points = {name: np.asarray(p, int) for name, p in raw.point_sets.items()}
    _add_families(raw, cells, points)
    return RawGroups(cells, points)


def _add(cells: CellGroups, name: str, block: int, members: HostArray):
    members = np.asarray(members, dtype=int)
    if members.size:
        own = cells.setdefault(name, {})
        own[block] = np.union1d(own.get(block, members), members)


def _add_sets(raw: meshio.Mesh, cells: CellGroups):
    for name, members in raw.cell_sets.items():
        if name.startswith("gmsh:"):
            continue
        cells.setdefault(name, {})
        for block, chosen in enumerate(members):
            if chosen is not None:
                _add(cells, name, block, np.asarray(chosen))


def _add_physical(raw: meshio.Mesh, cells: CellGroups):
    """Add Gmsh's physical tags; a tag without a name becomes e.g. "surface_7"."""
    names = {
        (int(entry[0]), int(entry[1])): name
        for name, entry in raw.field_data.items()
        if np.size(entry) == 2 and np.asarray(entry).dtype.kind in "iu"
    }
    for block, tags in enumerate(raw.cell_data.get("gmsh:physical", [])):
        tags, dim = np.asarray(tags), raw.cells[block].dim
        for tag in np.unique(tags[tags > 0]):
            name = names.get((int(tag), dim), f"{_KINDS[dim]}_{tag}")
            _add(cells, name, block, np.flatnonzero(tags == tag))


def _add_families(raw: meshio.Mesh, cells: CellGroups, points: dict[str, HostArray]):
    """Add MED's families, which meshio keeps as attributes that other formats lack."""
    for tag, names in getattr(raw, "cell_tags", {}).items():
        for block, tags in enumerate(raw.cell_data.get("cell_tags", [])):
            for name in names:
                _add(cells, name, block, np.flatnonzero(tags == tag))
    for tag, names in getattr(raw, "point_tags", {}).items():
        members = np.flatnonzero(raw.point_data["point_tags"] == tag)
        for name in names:
            points[name] = np.union1d(points.get(name, members), members)
