"""Reads a mesh file in a process of its own: `main`, run by `_apart`."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import meshio
import numpy as np

_KINDS = ("point", "line", "surface", "volume")
"""What a group without a name is called after, by its dimension."""


def read_msh(path: str, content: bytes) -> meshio.Mesh:
    """Read a .msh file by gmsh, or by meshio what that reads right.

    Raises:
        ValueError: If two physical groups have one name, or the file needs gmsh.
    """
    if not content.startswith((b"$MeshFormat", b"$NOD", b"$Comments")):
        # Gmsh would run it as a script.
        raise ValueError(f"it begins with {content[:20]!r}; expected $MeshFormat")
    listed = content.partition(b"$PhysicalNames")[2].partition(b"$End")[0]
    # Gmsh and meshio take a name to end at a quotation mark within it.
    rows = re.findall(r'(\d)\s+(\d+)\s+"(.*)"', listed.decode(errors="replace"))
    names = {(int(dimension), int(tag)): name for dimension, tag, name in rows}
    if twice := [name for name, n in Counter(names.values()).items() if n > 1]:
        raise ValueError(
            f"two physical groups have the name {twice[0]!r}; give each its own"
        )
    try:
        import gmsh  # pyright: ignore[reportMissingImports]
    except (ImportError, OSError) as error:  # the second without libraries of X
        version = content.partition(b"$MeshFormat")[2].split()[:1]
        if version in ([b"2"], [b"2.2"]) and not re.search(rb"\$ElementData", content):
            mesh = meshio.read(path, file_format="gmsh")
            mesh.field_data = {name: np.array(k[::-1]) for k, name in names.items()}
            return mesh
        raise ValueError(
            f"only gmsh reads it right, and it cannot be loaded ({error}): pip install "
            "'softcal-jax[cad]', or export the mesh in version 2.2, without data (in "
            "Gmsh, Mesh.MshFileVersion = 2.2)"
        ) from error
    return _by_gmsh(gmsh, path, names)


def _by_gmsh(gmsh: Any, path: str, names: dict[tuple[int, int], str]) -> meshio.Mesh:
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.merge(path)
    model, mesh = gmsh.model, gmsh.model.mesh
    numbers, points, _ = mesh.getNodes()
    points = points.reshape(-1, 3)[np.argsort(numbers)]
    numbers_of_nodes = np.sort(numbers)
    cells, elements, groups = [], [], defaultdict(set)
    for entity in model.getEntities():
        if model.getEntityType(*entity).startswith("Ghost"):
            continue  # its elements are those of other entities
        tags = np.unique(np.abs(model.getPhysicalGroupsForEntity(*entity))).tolist()
        for kind, numbers, nodes in zip(*mesh.getElements(*entity), strict=True):
            nodes = np.searchsorted(numbers_of_nodes, nodes).reshape(len(numbers), -1)
            if len(tags) > 1:  # versions 1 and 2 repeat an element for each group
                same = np.unique(np.sort(nodes), axis=0, return_index=True)
                nodes, numbers = nodes[np.sort(same[1])], numbers[np.sort(same[1])]
            name = meshio.gmsh.gmsh_to_meshio_type[kind]
            if name == "tetra10":
                nodes = nodes[:, [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]]
            for tag in tags:
                unnamed = f"{_KINDS[entity[0]]}_{tag}"
                groups[names.get((entity[0], tag), unnamed)].add(len(cells))
            cells.append((name, nodes))
            elements.append(numbers.tolist())
    data = {}
    for view in gmsh.view.getTags():
        kind, numbers, values, *_ = gmsh.view.getModelData(view, 0)
        if kind == "ElementData" and len(values):
            rows = dict(zip(numbers.tolist(), values, strict=True))
            nothing = np.full(len(values[0]), np.nan)
            data[gmsh.view.option.getString(view, "Name")] = [
                [rows.get(number, nothing) for number in block] for block in elements
            ]
    sets: Any = {
        name: [np.arange(len(c) * (k in blocks)) for k, (_, c) in enumerate(cells)]
        for name, blocks in groups.items()
    }
    return meshio.Mesh(points, cells, cell_data=data, cell_sets=sets)


def read_vtk(path: str, content: bytes) -> meshio.Mesh:
    """Read an unstructured grid of VTK, in text, binary or XML whatever its name."""
    import pyvista

    suffix = ".vtu" if content[:1000].lstrip().startswith(b"<") else ".vtk"
    with pyvista.VtkErrorCatcher(raise_errors=True, send_to_logging=False):
        grid: Any = pyvista.read(path, force_ext=suffix)
    mesh = pyvista.to_meshio(grid)
    names = {name.replace(" ", "_"): name for name in grid.cell_data}
    mesh.cell_data = {names[name]: data for name, data in mesh.cell_data.items()}
    for block in mesh.cells:  # those of order 1 and 2 are numbered as others are
        if block.type == "VTK_LAGRANGE_TETRAHEDRON":
            orders = {4: "tetra", 10: "tetra10"}
            block.type = orders.get(np.shape(block.data)[-1], block.type)
    return mesh


def with_sets(mesh: meshio.Mesh) -> meshio.Mesh:
    """Turn Gmsh's physical groups and MED's families into sets, whatever the format."""
    nothing = [np.zeros(0, int)] * len(mesh.cells)
    for name, block, members in _tagged(mesh):
        blocks: Any = mesh.cell_sets.setdefault(name, [*nothing])
        blocks[block] = np.union1d(blocks[block], members)
    for tag, names in getattr(mesh, "point_tags", {}).items():
        members = np.flatnonzero(mesh.point_data["point_tags"] == tag)
        for name in names:
            others = mesh.point_sets.get(name, members)
            mesh.point_sets[name] = np.union1d(others, members)
    return mesh


def _tagged(mesh: meshio.Mesh) -> Iterator[tuple[str, int, np.ndarray]]:
    """Yield the name of a group, a block, and the cells of the block in the group."""
    named = {
        (int(entry[0]), int(entry[1])): name
        for name, entry in mesh.field_data.items()
        if np.size(entry) == 2 and np.asarray(entry).dtype.kind in "iu"
    }
    for block, tags in enumerate(mesh.cell_data.get("gmsh:physical", [])):
        tags, dim = np.asarray(tags), mesh.cells[block].dim
        for tag in np.unique(tags[tags > 0]):
            # A tag without a name becomes e.g. "surface_7".
            name = named.get((int(tag), dim), f"{_KINDS[dim]}_{tag}")
            yield name, block, np.flatnonzero(tags == tag)
    # meshio keeps MED's families as attributes that other formats lack.
    for tag, names in getattr(mesh, "cell_tags", {}).items():
        for block, tags in enumerate(mesh.cell_data.get("cell_tags", [])):
            for name in names:
                yield name, block, np.flatnonzero(tags == tag)


def main(given: tuple[str, bytes]) -> meshio.Mesh:
    """Read a file, given its suffix and content, by the library of its format.

    It lies alone in its folder, since gmsh runs what lies beside a file, mesh.msh.opt.
    """
    suffix, content = given
    path = f"mesh{suffix}"
    Path(path).write_bytes(content)
    if suffix == ".med":
        return with_sets(meshio.read(path, file_format="med"))
    read = read_msh if suffix == ".msh" else read_vtk
    return with_sets(read(path, content))
