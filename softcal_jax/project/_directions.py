"""Tables of a project file that say where the fibres of each tet point.

Each computes the local axes of some tets, from which `theta` turns the fibre.
"""

from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from softcal_jax._typing import Float, HostArray
from softcal_jax.materials import frames_along, frames_around
from softcal_jax.mesh import TetMesh
from softcal_jax.project._table import Choice, Direction, Position, Table, by_type

TetData = Callable[[str], Float[HostArray, "n_tets _"]]
"""Returns an array of the mesh file by its name."""

Frames = Float[HostArray, "n 3 3"]
"""Local axes of some tets, see `Fibre`."""


class AlongTable(Table):
    type: Literal["along"]
    axis: Direction = Field(description='direction of the fibres: "z" or [0, 0, 1]')

    def frames(self, mesh: TetMesh, tets: HostArray, data: TetData) -> Frames:
        del mesh, data
        return frames_along(np.broadcast_to(np.asarray(self.axis), (len(tets), 3)))


class _AroundTable(Table):
    axis: Direction = Field(description='direction of the axis: "z" or [0, 0, 1]')
    through: Position = (0.0, 0.0, 0.0)

    def frames(self, mesh: TetMesh, tets: HostArray, data: TetData) -> Frames:
        del data
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
        del mesh
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
