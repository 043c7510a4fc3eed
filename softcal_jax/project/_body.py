"""From the tables of a project file to the body: mesh, groups, law, parameters."""

from pathlib import Path

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.fields import Parameter
from softcal_jax.materials import (
    AbstractLaw,
    Corotational,
    Isotropic,
    NeoHookean,
    StVenantKirchhoff,
)
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
from softcal_jax.project._problems import at
from softcal_jax.project._schema import (
    GroupTable,
    MaterialTable,
    MeshTable,
    ParameterTable,
    ProjectTable,
)

UNITS = {"E": "Pa", "density": "kg/m3", "nu": ""}
"""SI unit of each constant, as results name it."""


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


def build_body(path: Path, table: MaterialTable, mesh: TetMesh) -> Model:
    """The model with the constants of the file.

    Raises:
        ProjectError: If a constant is out of range, or a region is no tet group.
    """
    with at(path, "material"):
        E, nu, density = (_constant(mesh, table, key) for key in ("E", "nu", "density"))
        return build_model(
            mesh, _law(table.law, E, nu), density=density, formulation=table.formulation
        )


def _law(
    name: str, E: Float[HostArray, "..."], nu: Float[HostArray, "..."]
) -> AbstractLaw:
    if name == "neo-hookean":
        return NeoHookean(E, nu)
    if name == "corotational":
        return Corotational(Isotropic(E, nu))
    return StVenantKirchhoff(Isotropic(E, nu))


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


def build_parameters(
    path: Path, tables: tuple[ParameterTable, ...], material: MaterialTable
) -> tuple[Parameter, ...]:
    """The parameters; a start that is left out is the constant of the material.

    Raises:
        ProjectError: If bounds, start or scale do not fit.
    """
    parameters = []
    for table in tables:
        name = table.name or (
            table.field if table.region is None else f"{table.field}_{table.region}"
        )
        with at(path, f"parameters.{name}"):
            parameters.append(_parameter(name, table, material))
    return tuple(parameters)


def _parameter(name: str, table: ParameterTable, material: MaterialTable) -> Parameter:
    start = table.start
    if start is None:
        region = material.regions.get(table.region or "")
        own = None if region is None else getattr(region, table.field)
        start = getattr(material, table.field) if own is None else own
    if table.field == "nu" and not (-1.0 < table.lower and table.upper < 0.5):
        raise ValueError(
            "the bounds of nu must lie in (-1, 0.5), got "
            f"[{table.lower:g}, {table.upper:g}]."
        )
    if table.field != "nu" and table.lower <= 0.0:
        raise ValueError(f"lower must be positive, got {table.lower:g} (SI).")
    return Parameter(
        name,
        table.field,
        start,
        table.lower,
        table.upper,
        table.scale or ("linear" if table.field == "nu" else "log"),
        table.S,
        table.region,
        UNITS[table.field],
    )
