"""The keys of a project file that make the mesh and its groups."""

from typing import Literal

from pydantic import Field, model_validator

from softcal_jax.project._table import Integer, Length, Number, Position, Table, one_of


class BeamTable(Table):
    """A box of tets, long axis along x; its sides are groups "x_min" to "z_max"."""

    size: Position = Field(description='length, width, height: "(100, 30, 30) mm"')
    cells: tuple[Integer, Integer, Integer] = Field(
        description="cells along x, y and z: [14, 4, 4]"
    )
    origin: Position = (0.0, 0.0, 0.0)
    pattern: Literal["mirrored", "centred"] = "mirrored"


class MeshTable(Table):
    """The mesh: from a file, or a beam."""

    file: str | None = None
    length_unit: Literal["m", "cm", "mm", "um", "inch"] | None = None
    unused_nodes: Literal["error", "drop"] = "error"
    beam: BeamTable | None = None
    element: Literal["quadratic", "linear"] = "quadratic"

    @model_validator(mode="after")
    def _check(self) -> "MeshTable":
        if one_of(self, "file", "beam") == "file" and self.length_unit is None:
            raise ValueError('a mesh file needs its length_unit, like "mm".')
        return self


class BoxTable(Table):
    """All between two corners."""

    lower: Position = Field(description='a corner: "(0, 0, 0) mm"')
    upper: Position = Field(description='a corner: "(0, 30, 30) mm"')


class PlaneTable(Table):
    """All on a plane."""

    point: Position = Field(description='a point on the plane: "(0, 0, 0) mm"')
    normal: tuple[Number, Number, Number] = Field(description="[0, 0, 1]")


class SphereTable(Table):
    """All in a ball."""

    centre: Position = Field(description='its centre: "(0, 0, 0) mm"')
    radius: Length = Field(description='its radius: "5 mm"')


class GroupTable(Table):
    """A named part of the mesh, by where it is."""

    of: Literal["nodes", "faces", "tets"] = "nodes"
    box: BoxTable | None = None
    plane: PlaneTable | None = None
    sphere: SphereTable | None = None
    tolerance: Length | None = None

    @model_validator(mode="after")
    def _check(self) -> "GroupTable":
        one_of(self, "box", "plane", "sphere")
        return self
