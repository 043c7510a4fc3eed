"""Writing of meshes, with their groups, as files that other programs read."""

import os
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from softcal_jax._names import METRES, unknown_name
from softcal_jax._typing import HostArray
from softcal_jax.mesh._conversion import to_linear
from softcal_jax.mesh._tet_mesh import TetMesh


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
    if length_unit not in METRES:
        raise unknown_name("length unit", length_unit, METRES)
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
