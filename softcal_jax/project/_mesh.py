"""Tables of a project file that make the mesh and its groups."""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.exchange.cad import CAD_FORMATS, mesh_cad
from softcal_jax.mesh import (
    Annulus,
    Box,
    Cylinder,
    Plane,
    Sphere,
    TetMesh,
    beam,
    mesh_files,
    read_mesh,
    read_tet_data,
    select_cavity,
    select_face,
    select_faces,
    select_nodes,
    select_reachable,
)
from softcal_jax.project._table import (
    Angle,
    ByKeys,
    Corner,
    Direction,
    Extent,
    Integer,
    Length,
    Maker,
    Names,
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
    parts: Literal["one", "linked"] = "one"

    def build(self, folder: Path) -> TetMesh:
        """Read the mesh; its path is relative to `folder`."""
        return read_mesh(
            folder / self.file,
            length_unit=self.length_unit,
            order=self.order,
            unused=self.unused_nodes,
            parts=self.parts,
        )

    def files(self, folder: Path) -> tuple[Path, ...]:
        """List the file, and those that it includes."""
        return mesh_files(folder / self.file)

    def tet_data(self, folder: Path, name: str) -> Float[HostArray, "n_tets _"]:
        """Read an array of the file with values for each tet."""
        return read_tet_data(folder / self.file, name)


class CadMeshTable(_MeshTable):
    """A mesh that is made of a CAD model."""

    choice = 'file = "finger.step" or "finger.stl"'
    file: str = Field(description='a CAD model: "finger.step" or "finger.stl"')
    size: PositiveLength = Field(description='length of the edges of its tets: "3 mm"')
    length_unit: LengthUnit | None = None

    @classmethod
    def claims(cls, value: dict[str, Any]) -> bool:
        """Tell whether the file is a CAD model, by its extension."""
        return Path(str(value.get("file"))).suffix.lower() in CAD_FORMATS

    def build(self, folder: Path) -> TetMesh:
        """Make the mesh; the path of the model is relative to `folder`."""
        return mesh_cad(
            folder / self.file,
            size=self.size,
            length_unit=self.length_unit,
            order=self.order,
        )

    def files(self, folder: Path) -> tuple[Path, ...]:
        """List the CAD model."""
        return (folder / self.file,)

    def tet_data(self, folder: Path, name: str) -> Float[HostArray, "n_tets _"]:
        """Raise, since a CAD model has no values for tets."""
        del folder
        raise _no_tet_data(name, "made of a CAD model")


def _no_tet_data(name: str, mesh: str) -> ValueError:
    return ValueError(
        f"there is no mesh file to read {name!r} from; the mesh is {mesh}. Take "
        'type = "along", "hoop" or "helix", or a mesh of a file.'
    )


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
        raise _no_tet_data(name, "a beam")


MeshTable = Annotated[MeshFileTable | CadMeshTable | BeamMeshTable, ByKeys()]


class BoxTable(Maker):
    makes = Box
    lower: Corner = Field(description='a corner: "(0, 0, 0) mm"')
    upper: Corner = Field(description='a corner: "(0, 30, 30) mm"')


class PlaneTable(Maker):
    makes = Plane
    point: Position = Field(description='a point on the plane: "(0, 0, 0) mm"')
    normal: Direction = Field(description='its direction: "z" or [0, 0, 1]')


class SphereTable(Maker):
    makes = Sphere
    centre: Position = Field(description='its centre: "(0, 0, 0) mm"')
    radius: PositiveLength = Field(description='its radius: "5 mm"')


class CylinderTable(Maker):
    makes = Cylinder
    start: Position = Field(description='the middle of one end: "(0, 0, 0) mm"')
    end: Position = Field(description='the middle of the other end: "(10, 0, 0) mm"')
    radius: PositiveLength = Field(description='its radius: "5 mm"')


class AnnulusTable(Maker):
    makes = Annulus
    start: Position = Field(description='the middle of one end: "(0, 0, 0) mm"')
    end: Position = Field(description='the middle of the other end: "(10, 0, 0) mm"')
    inner: Length = Field(description='the radius of its hole: "4 mm"')
    outer: PositiveLength = Field(description='its outer radius: "6 mm"')


class FaceTable(Table):
    points: tuple[Position, ...] = Field(
        description='a point on each face: ["(0, 5, 0) mm"]'
    )

    @field_validator("points")
    @classmethod
    def _check_points(cls, value: tuple) -> tuple:
        if not value:
            raise ValueError('got no point; expected one or more, ["(0, 5, 0) mm"].')
        return value


class ReachableTable(Table):
    point: Position = Field(description='where it begins: "(0, 5, 0) mm"')
    angle: Angle | None = None
    stop_at: Names = ()


class InsideTable(Table):
    point: Position = Field(description='a point in the cavity: "(20, 0, 0) mm"')
    stop_at: Names = ()


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


class _SurfaceGroupTable(Table):
    """A named surface of the mesh, found from points."""

    def add(self, mesh: TetMesh, name: str) -> TetMesh:
        """Add the surface to the mesh; raise if there is none or the name is taken."""
        return mesh.with_surface_group(name, self.faces(mesh))

    def faces(self, mesh: TetMesh) -> Int[HostArray, "n n_fn"]:
        """Find its faces."""
        raise NotImplementedError


class BoxGroupTable(_GroupTable):
    box: BoxTable


class PlaneGroupTable(_GroupTable):
    plane: PlaneTable


class SphereGroupTable(_GroupTable):
    sphere: SphereTable


class CylinderGroupTable(_GroupTable):
    cylinder: CylinderTable


class AnnulusGroupTable(_GroupTable):
    annulus: AnnulusTable


class FaceGroupTable(_SurfaceGroupTable):
    face: FaceTable

    def faces(self, mesh: TetMesh) -> Int[HostArray, "n n_fn"]:
        """Find the faces at the points."""
        found = [select_face(mesh, np.array(point)) for point in self.face.points]
        return np.unique(np.concatenate(found), axis=0)


class ReachableGroupTable(_SurfaceGroupTable):
    reachable: ReachableTable

    def faces(self, mesh: TetMesh) -> Int[HostArray, "n n_fn"]:
        """Find the faces that are reached from the point."""
        own = self.reachable
        return select_reachable(
            mesh, np.array(own.point), angle=own.angle, stop_at=own.stop_at
        )


class InsideGroupTable(_SurfaceGroupTable):
    inside: InsideTable

    def faces(self, mesh: TetMesh) -> Int[HostArray, "n n_fn"]:
        """Find the wall of the cavity around the point."""
        point = np.array(self.inside.point)
        return select_cavity(mesh, point, stop_at=self.inside.stop_at)


GroupTable = Annotated[
    BoxGroupTable
    | PlaneGroupTable
    | SphereGroupTable
    | CylinderGroupTable
    | AnnulusGroupTable
    | FaceGroupTable
    | ReachableGroupTable
    | InsideGroupTable,
    ByKeys(),
]
