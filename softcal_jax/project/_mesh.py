"""Tables of a project file for the mesh, its groups, and directions of fibres in it."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, model_validator

from softcal_jax import mesh as meshes
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.exchange.cad import CAD_FORMATS, mesh_cad
from softcal_jax.materials import frames_along, frames_around
from softcal_jax.mesh import TetMesh
from softcal_jax.project import _quantities as typed
from softcal_jax.project._table import Choice, Maker, Table, by_keys, by_type

LengthUnit = Literal["m", "cm", "mm", "um", "inch"]


class _MeshTable(Table):
    element: Literal["quadratic", "linear"] = "quadratic"

    @property
    def order(self) -> int:
        return 2 if self.element == "quadratic" else 1

    @abstractmethod
    def build(self, folder: Path) -> TetMesh:
        """Make the mesh; paths are relative to `folder`."""

    def files(self, folder: Path) -> tuple[Path, ...]:
        return ()

    def tet_data(self, folder: Path, name: str) -> Float[HostArray, "n_tets _"]:
        """Read an array of a mesh file with values for each tet."""
        raise ValueError(
            f"there is no mesh file to read {name!r} from. Take "
            'type = "along", "hoop" or "helix", or a mesh of a file.'
        )


class MeshFileTable(_MeshTable):
    file: str = Field(description='a mesh file: "robot.msh"')
    length_unit: LengthUnit = Field(description='the length unit of the file: "mm"')
    unused_nodes: Literal["error", "drop"] = "error"
    parts: Literal["one", "linked"] = "one"

    def build(self, folder: Path) -> TetMesh:
        options = self.model_dump(include={"length_unit", "parts"})
        options |= {"order": self.order, "unused": self.unused_nodes}
        return meshes.read_mesh(folder / self.file, **options)

    def files(self, folder: Path) -> tuple[Path, ...]:
        return meshes.mesh_files(folder / self.file)

    def tet_data(self, folder: Path, name: str) -> Float[HostArray, "n_tets _"]:
        return meshes.read_tet_data(folder / self.file, name)


class CadMeshTable(_MeshTable):
    file: str = Field(description='a CAD model: "finger.step" or "finger.stl"')
    size: typed.PositiveLength = Field(description='length of its edges: "3 mm"')
    length_unit: LengthUnit | None = None

    def build(self, folder: Path) -> TetMesh:
        options = self.model_dump(include={"size", "length_unit"})
        path = folder / self.file
        return mesh_cad(path, order=self.order, kept_in=folder, **options)

    def files(self, folder: Path) -> tuple[Path, ...]:
        return (folder / self.file,)


class BeamTable(Table):
    """A box of tets, long along x; its sides are the groups "x_min" to "z_max"."""

    size: typed.Extent = Field(description='length, width, height: "(100, 30, 30) mm"')
    cells: tuple[typed.Integer, typed.Integer, typed.Integer] = Field(
        description="cells along x, y and z: [14, 4, 4]"
    )
    origin: typed.Position = (0.0, 0.0, 0.0)
    pattern: Literal["mirrored", "centred"] = "mirrored"


class BeamMeshTable(_MeshTable):
    beam: BeamTable

    def build(self, folder: Path) -> TetMesh:
        options = self.beam.model_dump(exclude={"size"})
        return meshes.beam(*self.beam.size, order=self.order, **options)


def _mesh_kind(value: Any, kinds: Sequence[type[BaseModel]]) -> type[BaseModel]:
    """Choose a table of a mesh; a CAD model is known by its file extension."""
    file = value.get("file") if isinstance(value, dict) else None
    if file is None:
        return by_keys(value, kinds)
    is_cad = Path(str(file)).suffix.lower() in CAD_FORMATS
    return CadMeshTable if is_cad else MeshFileTable


MeshTable = Annotated[MeshFileTable | CadMeshTable | BeamMeshTable, Choice(_mesh_kind)]


class BoxTable(Maker):
    makes = meshes.Box
    lower: typed.Corner = Field(description='a corner: "(0, 0, 0) mm"')
    upper: typed.Corner = Field(description='a corner: "(0, 30, 30) mm"')


class PlaneTable(Maker):
    makes = meshes.Plane
    point: typed.Position = Field(description='a point on the plane: "(0, 0, 0) mm"')
    normal: typed.Direction = Field(description='its direction: "z" or [0, 0, 1]')


class SphereTable(Maker):
    makes = meshes.Sphere
    centre: typed.Position = Field(description='its centre: "(0, 0, 0) mm"')
    radius: typed.PositiveLength = Field(description='its radius: "5 mm"')


class CylinderTable(Maker):
    makes = meshes.Cylinder
    start: typed.Position = Field(description='the middle of one end: "(0, 0, 0) mm"')
    end: typed.Position = Field(description='the middle of the other: "(10, 0, 0) mm"')
    radius: typed.PositiveLength = Field(description='its radius: "5 mm"')


class AnnulusTable(Maker):
    makes = meshes.Annulus
    start: typed.Position = Field(description='the middle of one end: "(0, 0, 0) mm"')
    end: typed.Position = Field(description='the middle of the other: "(10, 0, 0) mm"')
    inner: typed.Length = Field(description='the radius of its hole: "4 mm"')
    outer: typed.PositiveLength = Field(description='its outer radius: "6 mm"')


class _SurfaceTable(Table):
    """Faces that are selected by points."""

    @abstractmethod
    def faces(self, mesh: TetMesh) -> Int[HostArray, "n n_fn"]:
        """Find the faces; raise if there are none."""


class FaceTable(_SurfaceTable):
    points: tuple[typed.Position, ...] = Field(
        description='a point on each face: ["(0, 5, 0) mm"]', min_length=1
    )

    def faces(self, mesh: TetMesh) -> Int[HostArray, "n n_fn"]:
        faces = [meshes.select_face(mesh, np.array(point)) for point in self.points]
        return np.unique(np.concatenate(faces), axis=0)


class ReachableTable(_SurfaceTable):
    point: typed.Position = Field(description='where it begins: "(0, 5, 0) mm"')
    angle: typed.Angle | None = None
    stop_at: typed.Names = ()

    def faces(self, mesh: TetMesh) -> Int[HostArray, "n n_fn"]:
        options = self.model_dump(include={"angle", "stop_at"})
        return meshes.select_reachable(mesh, np.array(self.point), **options)


class InsideTable(_SurfaceTable):
    point: typed.Position = Field(description='a point in the cavity: "(20, 0, 0) mm"')
    stop_at: typed.Names = ()

    def faces(self, mesh: TetMesh) -> Int[HostArray, "n n_fn"]:
        """Find the wall of the cavity around the point."""
        return meshes.select_cavity(mesh, np.array(self.point), stop_at=self.stop_at)


class GroupTable(Table):
    """A named part of the mesh: nodes, faces or tets in a shape, or a surface."""

    box: BoxTable | None = None
    plane: PlaneTable | None = None
    sphere: SphereTable | None = None
    cylinder: CylinderTable | None = None
    annulus: AnnulusTable | None = None
    face: FaceTable | None = None
    reachable: ReachableTable | None = None
    inside: InsideTable | None = None
    of: Literal["nodes", "faces", "tets"] = "nodes"
    tolerance: typed.Length | None = None

    @model_validator(mode="after")
    def _check(self) -> "GroupTable":
        options = {"of", "tolerance"}
        places = [key for key in type(self).model_fields if key not in options]
        given = [key for key in places if key in self.model_fields_set]
        if len(given) != 1:
            raise ValueError(
                f"expected exactly one of {', '.join(places)}; got "
                f"{' and '.join(given) or 'none'}."
            )
        (place,) = given
        spare = sorted(options & self.model_fields_set)
        if spare and isinstance(getattr(self, place), _SurfaceTable):
            raise ValueError(f"{place} finds faces: leave {' and '.join(spare)} out.")
        return self

    def add(self, mesh: TetMesh, name: str) -> TetMesh:
        """Add the group to the mesh; raise if nothing is there or the name is taken."""
        (place,) = (part for _, part in self if isinstance(part, Maker | _SurfaceTable))
        if isinstance(place, _SurfaceTable):
            return mesh.with_surface_group(name, place.faces(mesh))
        # A millionth of the mesh: far below a cell, far above the rounding of a file.
        rounding = 1e-6 * mesh.size if self.tolerance is None else self.tolerance
        region = place.build(tolerance=rounding)
        if self.of == "nodes":
            return mesh.with_node_group(name, meshes.select_nodes(mesh, region))
        if self.of == "faces":
            return mesh.with_surface_group(name, meshes.select_faces(mesh, region))
        tets = np.flatnonzero(region(mesh.centroids))
        if not tets.size:
            raise ValueError("no tet has its centre there; check the length unit.")
        return mesh.with_tet_group(name, tets)


TetData = Callable[[str], Float[HostArray, "n_tets _"]]
"""Returns an array of the mesh file by its name."""

Frames = Float[HostArray, "n 3 3"]
"""Local axes of some tets, see `Fibre`."""


class AlongTable(Table):
    type: Literal["along"]
    axis: typed.Direction = Field(description='where fibres point: "z" or [0, 0, 1]')

    def frames(self, mesh: TetMesh, tets: HostArray, data: TetData) -> Frames:
        return frames_along(np.broadcast_to(np.asarray(self.axis), (len(tets), 3)))


class _AroundTable(Table):
    axis: typed.Direction = Field(description='direction of the axis: "z" or [0, 0, 1]')
    through: typed.Position = (0.0, 0.0, 0.0)

    def frames(self, mesh: TetMesh, tets: HostArray, data: TetData) -> Frames:
        return frames_around(mesh.centroids[tets], self.axis, self.through)


class HelixTable(_AroundTable):
    """Fibres around an axis, at the angle `theta` from it."""

    type: Literal["helix"]


class HoopTable(_AroundTable):
    type: Literal["hoop"]

    def frames(self, mesh: TetMesh, tets: HostArray, data: TetData) -> Frames:
        return super().frames(mesh, tets, data)[:, [2, 1, 0]]


class CellsTable(Table):
    """Fibres from an array of the mesh file, with a vector for each tet."""

    type: Literal["cells"]
    array: str = Field(description='name of a cell array of the mesh file: "fibre"')

    def frames(self, mesh: TetMesh, tets: HostArray, data: TetData) -> Frames:
        vectors = data(self.array)
        if vectors.shape[1:] != (3,):
            raise ValueError(
                f"the cell array {self.array!r} has the shape {vectors.shape}; "
                "expected a vector of three components for each tet."
            )
        return frames_along(vectors[tets])


AnyDirections = Annotated[
    AlongTable | HoopTable | HelixTable | CellsTable, Choice(by_type)
]
