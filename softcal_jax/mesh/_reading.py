"""Reading of mesh files as a `TetMesh` in metres, and writing with all groups.

Libraries read in a process of their own (`_program.py`), and either return a mesh or
raise a `ValueError` that names the file; Abaqus files are read here. Whatever a format
calls them, groups are sets of cells and of points from there on.
"""

import os
import warnings
from collections import Counter
from functools import lru_cache
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from softcal_jax._apart import run_apart
from softcal_jax._files import check_file
from softcal_jax._module import key, keys
from softcal_jax._places import TETS, LimitError
from softcal_jax._text import SoftcalWarning, check_known, escaped, unknown_name
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import METRES
from softcal_jax.mesh._inp import included_files, read_inp
from softcal_jax.mesh._tet_mesh import TetMesh, to_linear, to_quadratic
from softcal_jax.mesh._topology import check_mesh, tet_faces, volumes

FORMATS = (".msh", ".vtu", ".vtk", ".inp", ".med")
"""Extensions of files that `read_mesh` reads."""


class MeshWarning(SoftcalWarning):
    """A mesh file was read, but not all of its content was used."""


@lru_cache(maxsize=4)  # sweeps and notebooks read a mesh again and again
def _by_library(suffix: str, content: bytes) -> tuple[meshio.Mesh, str]:
    return run_apart(Path(__file__).with_name("_program.py"), (suffix, content))


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


_SMALL = 5e-4  # a mesh below this size [m] may have a wrong unit

_TETS = ("tetra", "tetra10")
_TRIANGLES = ("triangle", "triangle6")
_OTHERS = ("line", "line3", "vertex")  # cells of which groups keep the nodes alone
# Exchanges corners 1 and 2, and the mid nodes accordingly.
_MIRRORED = [0, 2, 1, 3, 6, 5, 4, 7, 9, 8]


@keys(
    path=key(words='a mesh file: "robot.msh"', key="file"),
    length_unit=key(words='the length unit of the file: "mm"'),
    unused=key(key="unused_nodes"),
    parts=key(),
)
def read_mesh(
    path: str | os.PathLike[str],
    *,
    length_unit: str,
    order: int | None = None,
    unused: str = "error",
    parts: str = "one",
) -> TetMesh:
    """Read the tets and the named groups of a mesh file, and check them.

    Formats: Gmsh .msh (of any version; without gmsh installed, 2.2), .vtu, .vtk, Abaqus
    .inp and .med. Physical groups, sets and families become groups: all their nodes in
    `node_groups`, their triangles in `surface_groups`, their tets in `tet_groups`. A
    physical group without a name is called after its kind and tag, e.g. "surface_7".
    Surfaces, lines and points that are no part of a group are left out with a warning,
    and so are the nodes that only they use, such as circle centres of Gmsh.

    Args:
        path: The file.
        length_unit: Unit of its coordinates: "m", "cm", "mm", "um" or "inch".
        order: 1 or 2 to convert to that order; None keeps the order of the file.
        unused: What to do with nodes that no cell uses: "error" or "drop".
        parts: "one" refuses parts that share no face; "linked" leaves that to
            `build_model`, which knows the rigid bodies that link them.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file cannot be read, an option is unknown, there are no tets,
            other volumes beside them or linear ones among quadratic ones, nodes are
            unused, or `check_mesh` refuses the mesh.

    Warns:
        MeshWarning: If something is left out, or the size suggests a wrong unit.
    """
    check_known("length unit", METRES, length_unit)
    if order not in (None, 1, 2):
        raise ValueError(f"order must be 1, 2 or None, got {order}.")
    check_known("choice for unused nodes", ("error", "drop"), unused)
    check_known("choice for parts", ("one", "linked"), parts)
    path = Path(path)
    notes: list[str] = []
    raw = read_raw(path, notes)
    try:
        mesh = _build(path, raw, METRES[length_unit], unused, notes)
        together = [np.arange(mesh.n_nodes)] if parts == "linked" else []
        check_mesh(mesh, linked=together)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    if mesh.size < _SMALL and length_unit != "um":
        notes.append(f"it is {mesh.size:.3g} m across; is it in {length_unit!r}?")
    for note in notes:
        warnings.warn(f"{path}: {note}", MeshWarning, stacklevel=2)
    if order in (None, mesh.order):
        return mesh
    return to_quadratic(mesh) if order == 2 else to_linear(mesh)


def mesh_files(path: str | os.PathLike[str]) -> tuple[Path, ...]:
    """List what `read_mesh` reads: a file, and those that an Abaqus file includes."""
    path = Path(path)
    included = included_files(path) if path.suffix.lower() == ".inp" else []
    return (path, *included)


def read_tet_data(
    path: str | os.PathLike[str], name: str
) -> Float[HostArray, "n_tets n_components"]:
    """Read a cell array of a mesh file, one row per tet, in the units of the file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file cannot be read or has no such array; the text lists
            those that it has.
    """
    path = Path(path)
    raw = read_raw(path, [])
    if name not in raw.cell_data:
        raise ValueError(f"{path}: {unknown_name('cell array', name, raw.cell_data)}")
    values = raw.cell_data_dict[name]
    rows = np.concatenate([values[kind] for kind in _TETS if len(values.get(kind, ()))])
    return rows.astype(float).reshape(len(rows), -1)


def _build(
    path: Path, raw: meshio.Mesh, scale: float, unused: str, notes: list[str]
) -> TetMesh:
    tets = raw.get_cells_type(_kind_of_tets(raw))
    if raw.points.ndim != 2 or raw.points.shape[1] != 3:
        raise ValueError(f"its points have the shape {raw.points.shape}, not (n, 3).")
    for block in raw.cells:
        cells = np.asarray(block.data)
        if cells.size and (cells.min() < 0 or cells.max() >= len(raw.points)):
            raise ValueError(f"a {block.type} cell refers to a node that is not there.")
    notes += _left_out(raw)
    index = _new_indices(raw, tets, unused)
    points, tets = raw.points[index >= 0] * scale, index[tets]
    left_handed = path.suffix.lower() == ".med"  # the convention of MED
    if left_handed and (volumes(TetMesh(points, tets[:, :4])) < 0).all():
        tets = tets[:, _MIRRORED[: tets.shape[1]]]
    return _with_groups(raw, TetMesh(points, tets), index, notes)


def _kind_of_tets(raw: meshio.Mesh) -> str:
    """Return what meshio calls the tets, of which alone the volume must be."""
    kinds = Counter()
    for block in raw.cells:
        kinds[block.type] += len(block)
    listed = ", ".join(f"{n} {kind}" for kind, n in kinds.items()) or "no cells"
    if not (kinds["tetra"] or kinds["tetra10"]):
        raise ValueError(
            f"it has no tetrahedra of 4 or 10 nodes; it has {listed}. Fill surfaces "
            "with tets (in Gmsh, a Surface Loop, a Volume and Mesh > 3D) and split "
            "other cells into tets. If there are tets already, give their volume a "
            "physical group too: Gmsh leaves out what is in none as soon as something "
            "is in one."
        )
    if any(b.dim == 3 and len(b) and b.type not in _TETS for b in raw.cells):
        raise ValueError(
            f"its volume is not of tets alone; it has {listed}. Without the other "
            "cells the body would have holes: split them into tets, or remove them."
        )
    TETS.check("it is too large", kinds["tetra"] + kinds["tetra10"])
    if kinds["tetra"] and kinds["tetra10"]:
        raise ValueError(
            f"it mixes {kinds['tetra']} linear (tetra) and {kinds['tetra10']} "
            "quadratic (tetra10) tets; export it with one order."
        )
    return "tetra" if kinds["tetra"] else "tetra10"


def _left_out(raw: meshio.Mesh) -> list[str]:
    left_out, sets = Counter(), raw.cell_sets_dict.values()
    for block in raw.cells:
        if block.type not in _TETS:
            left_out[block.type] += len(block)
    for kind in left_out.keys() & {*_TRIANGLES, *_OTHERS}:
        left_out[kind] -= len({cell for of in sets for cell in of.get(kind, ())})
    listed = ", ".join(f"{n} {kind}" for kind, n in left_out.items() if n)
    note = (
        f"left out: {listed}. Tets are read; triangles, lines and vertices only where "
        "they belong to a named group."
    )
    return [note] if listed else []


def _new_indices(raw: meshio.Mesh, tets: HostArray, unused: str) -> HostArray:
    """Compute the new index of each node of the file, -1 if no tet uses it."""
    kept, known = np.zeros((2, len(raw.points)), dtype=bool)
    kept[tets] = True
    for block in raw.cells:
        known[np.asarray(block.data)] = True
    loose = np.flatnonzero(~known)
    if loose.size and unused == "error":
        raise ValueError(
            f"{loose.size} of its {len(known)} nodes are unused (no cell refers to "
            f"them): {loose[:5].tolist()}{', ...' * (loose.size > 5)} counted from 0. "
            'Remove them, or read with unused="drop".'
        )
    return np.where(kept, np.cumsum(kept) - 1, -1)


def _with_groups(
    raw: meshio.Mesh, mesh: TetMesh, index: HostArray, notes: list[str]
) -> TetMesh:
    kinds, sets = (*_TETS, *_TRIANGLES, *_OTHERS), raw.cell_sets_dict
    cells = {kind: raw.get_cells_type(kind) for kind in kinds}
    node_groups, surface_groups, tet_groups = {}, {}, {}
    all_faces = tet_faces(mesh.tets)
    corners = np.sort(all_faces[:, :3], axis=1).tolist()
    position = {tuple(face): where for where, face in enumerate(corners)}
    for label in {**sets, **raw.point_sets}:
        name = escaped(label)
        members = {k: of for k, of in sets.get(label, {}).items() if k in kinds}
        used = {kind: index[cells[kind][of]] for kind, of in members.items()}
        nodes = np.concatenate([np.empty(0, int), *map(np.ravel, used.values())])
        if label in raw.point_sets:  # also where a set of elements is called the same
            nodes = index[np.asarray(raw.point_sets[label], int)]
        nodes = np.unique(nodes[nodes >= 0])
        if not nodes.size:
            notes.append(f"left out: group {name!r}, which has no node of a tet.")
            continue
        node_groups[name] = nodes
        if (kind := _TETS[mesh.order - 1]) in members:
            tet_groups[name] = members[kind]
        triangles = [used[kind][:, :3] for kind in _TRIANGLES if kind in used]
        if triangles:
            # Of either orientation; `all_faces` have mid nodes and outward normals.
            corners = np.sort(np.concatenate(triangles), axis=1).tolist()
            each = dict.fromkeys(map(tuple, corners))
            faces = [position[face] for face in each if face in position]
            if faces:
                surface_groups[name] = all_faces[faces]
            if lost := len(corners) - len(faces):
                notes.append(
                    f"left out: {lost} of the {len(corners)} triangles of group "
                    f"{name!r}, which repeat or are not faces of a tet."
                )
    return TetMesh(mesh.points, mesh.tets, node_groups, surface_groups, tet_groups)


def write_mesh(
    mesh: TetMesh, path: str | os.PathLike[str], *, length_unit: str = "mm"
) -> None:
    """Write the tets and all groups of a mesh as Gmsh 2.2, linear.

    `read_mesh` gives the same mesh again, with order=2 also a quadratic one if its
    edges are straight. Groups become physical groups: those of tets of dimension 3, of
    surfaces of dimension 2, of other nodes of dimension 0. The unit of the coordinates
    is "m", "cm", "mm", "um" or "inch".

    Raises:
        ValueError: If the name does not end in .msh, the unit is unknown, or a tet
            belongs to two groups, which the format cannot hold.
        OSError: If the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".msh":
        raise ValueError(f"{path} ends in {path.suffix!r}; expected .msh, of Gmsh.")
    check_known("length unit", METRES, length_unit)
    mesh = mesh if mesh.order == 1 else to_linear(mesh)
    names: dict[str, tuple[int, int]] = {}
    blocks: list[tuple[str, HostArray, int]] = []
    grouped = np.zeros(mesh.n_tets, int)
    for name, tets in mesh.tet_groups.items():
        grouped[tets] += 1
        blocks.append(("tetra", mesh.tets[tets], _tag(names, name, 3)))
    if grouped.max() > 1:
        raise ValueError(
            f"{path}: {np.sum(grouped > 1)} tets belong to several of the tet groups "
            f"{', '.join(map(repr, mesh.tet_groups))}, and a Gmsh file has one for "
            "each. Leave out those that overlap."
        )
    if (rest := mesh.tets[grouped == 0]).size:
        blocks.insert(0, ("tetra", rest, 0))
    for name, faces in mesh.surface_groups.items():
        blocks.append(("triangle", faces, _tag(names, name, 2)))
    for name, nodes in mesh.node_groups.items():
        tets = mesh.tets[mesh.tet_groups.get(name, np.zeros(0, int))]
        implied = np.unique(mesh.surface_groups.get(name, tets))
        if not np.array_equal(np.unique(nodes), implied):
            blocks.append(("vertex", nodes[:, None], _tag(names, name, 0)))
    tags: list[Any] = [np.full(len(cells), tag, np.int32) for _, cells, tag in blocks]
    meshio.Mesh(
        mesh.points / METRES[length_unit],
        [(kind, cells) for kind, cells, _ in blocks],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={name: np.array(tag, np.int32) for name, tag in names.items()},
    ).write(path, file_format="gmsh22", binary=False)


def _tag(names: dict[str, tuple[int, int]], name: str, dimension: int) -> int:
    """Give a group its tag; a file knows each name once."""
    if name in names:
        raise ValueError(
            f"two groups of different kinds have the name {name!r}; rename one of them "
            "for a Gmsh file."
        )
    names[name] = (len(names) + 1, dimension)
    return names[name][0]
