"""Tables of a project file for the mesh, its groups, and directions of fibres in it."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, create_model, model_validator

from softcal_jax import mesh as meshes
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.exchange.cad import CAD_FORMATS, mesh_cad
from softcal_jax.materials import frames_along, frames_around
from softcal_jax.mesh import TetMesh
from softcal_jax.project import _quantities as typed
from softcal_jax.project._table import (
    Choice,
    File,
    Maker,
    Table,
    by_keys,
    of_type,
    table_of,
)

LengthUnit = Literal["m", "cm", "mm", "um", "inch"]


class _MeshTable(Table):
    element: Literal["quadratic", "linear"] = "quadratic"

    @property
    def order(self) -> int:
        return 2 if self.element == "quadratic" else 1

    @abstractmethod
    def build(self, folder: Path) -> TetMesh:
        """Make the mesh; what is costly to make is kept in `folder`."""

    def tet_data(self, name: str) -> Float[HostArray, "n_tets _"]:
        """Read an array of a mesh file with values for each tet."""
        raise ValueError(
            f"there is no mesh file to read {name!r} from. Take "
            'type = "along", "hoop" or "helix", or a mesh of a file.'
        )


class MeshFileTable(_MeshTable):
    file: File = Field(description='a mesh file: "robot.msh"')
    length_unit: LengthUnit = Field(description='the length unit of the file: "mm"')
    unused_nodes: Literal["error", "drop"] = "error"
    parts: Literal["one", "linked"] = "one"

    def build(self, folder: Path) -> TetMesh:
        options = self.model_dump(include={"length_unit", "parts"})
        options |= {"order": self.order, "unused": self.unused_nodes}
        return meshes.read_mesh(self.file, **options)

    def tet_data(self, name: str) -> Float[HostArray, "n_tets _"]:
        return meshes.read_tet_data(self.file, name)


class CadMeshTable(_MeshTable):
    file: File = Field(description='a CAD model: "finger.step" or "finger.stl"')
    size: typed.PositiveLength = Field(description='length of its edges: "3 mm"')
    length_unit: LengthUnit | None = None

    def build(self, folder: Path) -> TetMesh:
        options = self.model_dump(include={"size", "length_unit"})
        return mesh_cad(self.file, order=self.order, kept_in=folder, **options)


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


class FaceTable(Table):
    points: tuple[typed.Position, ...] = Field(
        description='a point on each face: ["(0, 5, 0) mm"]', min_length=1
    )

    def faces(self, mesh: TetMesh) -> Int[HostArray, "n n_fn"]:
        faces = [meshes.select_face(mesh, np.array(point)) for point in self.points]
        return np.unique(np.concatenate(faces), axis=0)


class ReachableTable(Table):
    point: typed.Position = Field(description='where it begins: "(0, 5, 0) mm"')
    angle: typed.Angle | None = None
    stop_at: typed.Names = ()

    def faces(self, mesh: TetMesh) -> Int[HostArray, "n n_fn"]:
        options = self.model_dump(include={"angle", "stop_at"})
        return meshes.select_reachable(mesh, np.array(self.point), **options)


class InsideTable(Table):
    point: typed.Position = Field(description='a point in the cavity: "(20, 0, 0) mm"')
    stop_at: typed.Names = ()

    def faces(self, mesh: TetMesh) -> Int[HostArray, "n n_fn"]:
        """Find the wall of the cavity around the point."""
        return meshes.select_cavity(mesh, np.array(self.point), stop_at=self.stop_at)


_REGIONS: dict[str, Any] = {
    key: (table_of(kind, "tolerance") | None, None)
    for key, kind in meshes.REGIONS.items()
}


class GroupTable(create_model("Group", __base__=Table, **_REGIONS)):
    """A named part of the mesh: nodes, faces or tets in a region, or a surface."""

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
        spare = sorted(options & self.model_fields_set)
        if spare and given[0] not in meshes.REGIONS:
            raise ValueError(
                f"{given[0]} finds faces: leave {' and '.join(spare)} out."
            )
        return self

    def add(self, mesh: TetMesh, name: str) -> TetMesh:
        """Add the group to the mesh; raise if nothing is there or the name is taken."""
        surface = self.face or self.reachable or self.inside
        if surface is not None:
            return mesh.with_surface_group(name, surface.faces(mesh))
        # A millionth of the mesh: far below a cell, far above the rounding of a file.
        rounding = 1e-6 * mesh.size if self.tolerance is None else self.tolerance
        place = next(part for _, part in self if isinstance(part, Maker))
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
    type: str
    axis: typed.Direction = Field(description='where fibres point: "z" or [0, 0, 1]')

    def frames(self, mesh: TetMesh, tets: HostArray, data: TetData) -> Frames:
        return frames_along(np.broadcast_to(np.asarray(self.axis), (len(tets), 3)))


class AroundTable(Table):
    """Fibres around an axis: hoops, or a helix at the angle `theta` from it."""

    axis: typed.Direction = Field(description='direction of the axis: "z" or [0, 0, 1]')
    through: typed.Position = (0.0, 0.0, 0.0)
    type: str

    def frames(self, mesh: TetMesh, tets: HostArray, data: TetData) -> Frames:
        frames = frames_around(mesh.centroids[tets], self.axis, self.through)
        return frames[:, [2, 1, 0]] if self.type == "hoop" else frames


class CellsTable(Table):
    """Fibres from an array of the mesh file, with a vector for each tet."""

    type: str
    array: str = Field(description='name of a cell array of the mesh file: "fibre"')

    def frames(self, mesh: TetMesh, tets: HostArray, data: TetData) -> Frames:
        vectors = data(self.array)
        if vectors.shape[1:] != (3,):
            raise ValueError(
                f"the cell array {self.array!r} has the shape {vectors.shape}; "
                "expected a vector of three components for each tet."
            )
        return frames_along(vectors[tets])


DIRECTIONS: dict[str, type[Table]] = {
    "along": AlongTable,
    "hoop": AroundTable,
    "helix": AroundTable,
    "cells": CellsTable,
}
AnyDirections = Annotated[Any, of_type(DIRECTIONS)]
