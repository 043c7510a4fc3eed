"""From the tables of a project file to the body: mesh, groups, law."""

from pathlib import Path

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.mesh import (
    Box,
    Plane,
    Sphere,
    TetMesh,
    beam,
    read_mesh,
    select_faces,
    select_nodes,
)
from softcal_jax.project._laws import build_law
from softcal_jax.project._mechanism import Parts
from softcal_jax.project._problems import at
from softcal_jax.project._schema import ProjectTable
from softcal_jax.project._schema_material import MaterialTable
from softcal_jax.project._schema_mesh import GroupTable, MeshTable


def build_mesh(path: Path, table: ProjectTable) -> TetMesh:
    """The mesh with the groups that the project adds.

    Raises:
        ProjectError: If the mesh cannot be made, or a group is empty or named twice.
    """
    with at(path, "mesh"):
        mesh = _mesh(path.parent, table.mesh)
    for name, group in table.groups.items():
        with at(path, f"groups.{name}"):
            mesh = _with_group(mesh, name, group)
    return mesh


def _mesh(folder: Path, table: MeshTable) -> TetMesh:
    order = 2 if table.element == "quadratic" else 1
    if table.beam is not None:
        made = table.beam
        return beam(
            *made.size,
            made.cells,
            origin=made.origin,
            order=order,
            pattern=made.pattern,
        )
    return read_mesh(
        folder / str(table.file),
        length_unit=str(table.length_unit),
        order=order,
        unused=table.unused_nodes,
    )


def _with_group(mesh: TetMesh, name: str, table: GroupTable) -> TetMesh:
    # A millionth of the body: far below a cell, far above the rounding of a file.
    tolerance = 1e-6 * mesh.size if table.tolerance is None else table.tolerance
    if table.box is not None:
        region = Box(lower=table.box.lower, upper=table.box.upper, tolerance=tolerance)
    elif table.plane is not None:
        region = Plane(
            point=table.plane.point, normal=table.plane.normal, tolerance=tolerance
        )
    elif table.sphere is not None:
        region = Sphere(
            centre=table.sphere.centre,
            radius=table.sphere.radius,
            tolerance=tolerance,
        )
    else:
        raise AssertionError("the schema asks for one of the three")
    if table.of == "nodes":
        return mesh.with_node_group(name, select_nodes(mesh, region))
    if table.of == "faces":
        return mesh.with_surface_group(name, select_faces(mesh, region))
    centres = mesh.points[mesh.tets[:, :4]].mean(axis=1)
    tets = np.flatnonzero(region(centres))
    if not tets.size:
        raise ValueError("no tet has its centre there; check the length unit.")
    return mesh.with_tet_group(name, tets)


def build_body(path: Path, table: ProjectTable, mesh: TetMesh, parts: Parts) -> Model:
    """The model with the constants of the file.

    Args:
        path: The project file, for messages.
        table: Its tables.
        mesh: The mesh.
        parts: Rigid bodies and actuators, which fit the mesh.

    Raises:
        ProjectError: If a constant is out of range, a region is no tet group, or the
            solver cannot be had.
    """
    material = table.material
    with at(path, "material"):
        law = build_law(material, lambda key: _constant(mesh, material, key))
        density = _constant(mesh, material, "density")
        return build_model(
            mesh,
            law,
            density=density,
            bodies=parts[0],
            actuators=parts[1],
            formulation=material.formulation,
            solver=table.newton.solver,
        )


def _constant(mesh: TetMesh, table: MaterialTable, key: str) -> Float[HostArray, "..."]:
    """A constant of the whole body, or one value per tet where regions differ."""
    base = np.asarray(getattr(table, key), float)
    for name, region in table.regions.items():
        tets = mesh.tets_of(name)
        value = getattr(region, key)
        if value is not None:
            base = np.broadcast_to(base, (mesh.n_tets,)).copy()
            base[tets] = value
    return base
