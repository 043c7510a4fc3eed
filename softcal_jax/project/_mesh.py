"""Tables of a project file that make the mesh and its groups."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from softcal_jax._typing import Float, HostArray
from softcal_jax.mesh import (
    Box,
    Plane,
    Sphere,
    TetMesh,
    beam,
    mesh_files,
    read_mesh,
    read_tet_data,
    select_faces,
    select_nodes,
)
from softcal_jax.project._table import (
    ByKeys,
    Corner,
    Extent,
    Integer,
    Length,
    Maker,
    Number,
    Position,
    PositiveLength,
    Table,
)

LengthUnit = Literal["m", "cm", "mm", "um", "inch"]


class _MeshTable(Table):
    element: Literal["quadratic", "linear"] = "quadratic"

    @property
    def order(self) -> int:
        """Order of the shape functions."""
        return 2 if self.element == "quadratic" else 1


class MeshFileTable(_MeshTable):
    """A mesh from a file."""

    file: str = Field(description='a mesh file: "robot.msh"')
    length_unit: LengthUnit = Field(description='the length unit of the file: "mm"')
    unused_nodes: Literal["error", "drop"] = "error"

    def build(self, folder: Path) -> TetMesh:
        """Read the mesh; its path is relative to `folder`."""
        return read_mesh(
            folder / self.file,
            length_unit=self.length_unit,
            order=self.order,
            unused=self.unused_nodes,
        )

    def files(self, folder: Path) -> tuple[Path, ...]:
        """List the file, and those that it includes."""
        return mesh_files(folder / self.file)

    def tet_data(self, folder: Path, name: str) -> Float[HostArray, "n_tets _"]:
        """Read an array of the file with values for each tet."""
        return read_tet_data(folder / self.file, name)


class BeamTable(Table):
    """A box of tets, long along x; its sides are the groups "x_min" to "z_max"."""

    size: Extent = Field(description='length, width, height: "(100, 30, 30) mm"')
    cells: tuple[Integer, Integer, Integer] = Field(
        description="cells along x, y and z: [14, 4, 4]"
    )
    origin: Position = (0.0, 0.0, 0.0)
    pattern: Literal["mirrored", "centred"] = "mirrored"


class BeamMeshTable(_MeshTable):
    """A mesh of a beam."""

    beam: BeamTable

    def build(self, folder: Path) -> TetMesh:
        """Build the mesh."""
        del folder
        options = self.beam.model_dump(exclude={"size"})
        return beam(*self.beam.size, order=self.order, **options)

    def files(self, folder: Path) -> tuple[Path, ...]:
        """List none."""
        del folder
        return ()

    def tet_data(self, folder: Path, name: str) -> Float[HostArray, "n_tets _"]:
        """Raise, since there is no file."""
        del folder
        raise ValueError(
            f"there is no mesh file to read {name!r} from; the mesh is a beam. Take "
            'type = "along", "hoop" or "helix", or a mesh of a file.'
        )


MeshTable = Annotated[MeshFileTable | BeamMeshTable, ByKeys()]


class BoxTable(Maker):
    makes = Box
    lower: Corner = Field(description='a corner: "(0, 0, 0) mm"')
    upper: Corner = Field(description='a corner: "(0, 30, 30) mm"')


class PlaneTable(Maker):
    makes = Plane
    point: Position = Field(description='a point on the plane: "(0, 0, 0) mm"')
    normal: tuple[Number, Number, Number] = Field(description="[0, 0, 1]")


class SphereTable(Maker):
    makes = Sphere
    centre: Position = Field(description='its centre: "(0, 0, 0) mm"')
    radius: PositiveLength = Field(description='its radius: "5 mm"')


class _GroupTable(Table):
    """A named part of the mesh, chosen by place."""

    of: Literal["nodes", "faces", "tets"] = "nodes"
    tolerance: Length | None = None

    def add(self, mesh: TetMesh, name: str) -> TetMesh:
        """Add the group to the mesh; raise if nothing is there or the name is taken."""
        (where,) = (own for _, own in self if isinstance(own, Maker))
        # A millionth of the mesh: far below a cell, far above the rounding of a file.
        rounding = 1e-6 * mesh.size if self.tolerance is None else self.tolerance
        region = where.makes(**where.model_dump(), tolerance=rounding)
        if self.of == "nodes":
            return mesh.with_node_group(name, select_nodes(mesh, region))
        if self.of == "faces":
            return mesh.with_surface_group(name, select_faces(mesh, region))
        tets = np.flatnonzero(region(mesh.centroids))
        if not tets.size:
            raise ValueError("no tet has its centre there; check the length unit.")
        return mesh.with_tet_group(name, tets)


class BoxGroupTable(_GroupTable):
    box: BoxTable


class PlaneGroupTable(_GroupTable):
    plane: PlaneTable


class SphereGroupTable(_GroupTable):
    sphere: SphereTable


GroupTable = Annotated[BoxGroupTable | PlaneGroupTable | SphereGroupTable, ByKeys()]
