"""Tables of a project file that make supports and loads.

To add a load, write one table and list it in `AnyLoad`.
"""

from typing import Annotated

from pydantic import BeforeValidator, Field

from softcal_jax.configurations import (
    EdgeForce,
    PointForce,
    Support,
    SurfaceForce,
    SurfaceTraction,
)
from softcal_jax.project._quantities import BEDDING, scalar
from softcal_jax.project._table import ByKeys, Force, Maker, Position, Traction

_SURFACE = Field(description='name of a surface group: "z_max"')
_FORCE = Field(description='the total force: "(0, 0, -1) N"')


class SupportTable(Maker):
    """Nodes that are held, or moved by a given displacement."""

    makes = Support

    group: str = Field(description="name of a group of the mesh")
    axes: str = "xyz"
    displacement: Position = (0.0, 0.0, 0.0)
    stiffness: Annotated[float, BeforeValidator(scalar(BEDDING))] | None = None


class PointForceTable(Maker):
    """A dead load at a point."""

    makes = PointForce

    point: Position = Field(description='where it acts: "(50, 10, 0) mm"')
    force: Force = _FORCE


class EdgeForceTable(Maker):
    """A dead load along an edge."""

    makes = EdgeForce

    edge: str = Field(description="name of the node group of an edge")
    force: Force = _FORCE


class SurfaceForceTable(Maker):
    """A dead load spread over a surface."""

    makes = SurfaceForce

    surface: str = _SURFACE
    force: Force = _FORCE


class SurfaceTractionTable(Maker):
    """A dead load per area of a surface."""

    makes = SurfaceTraction

    surface: str = _SURFACE
    traction: Traction = Field(description='force per area: "(0, 0, -1) kPa"')


AnyLoad = Annotated[
    PointForceTable | EdgeForceTable | SurfaceForceTable | SurfaceTractionTable,
    ByKeys(),
]
