"""Tables of a project file that make the shapes of obstacles.

To add a shape, write one table with the keys of its class.
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from softcal_jax import contact
from softcal_jax._files import check_file
from softcal_jax._units import METRES
from softcal_jax.contact import AbstractShape
from softcal_jax.project import _quantities as typed
from softcal_jax.project._mesh import LengthUnit
from softcal_jax.project._table import Choice, Maker, by_type

SURFACE_FORMATS = ".stl", ".ply", ".obj", ".vtp"


class ShapeTable(Maker):
    """The shape of an obstacle, in the frame of its rigid body."""

    def shape(self, folder: Path) -> AbstractShape:
        """Make the shape; paths are relative to `folder`."""
        return self.build()

    def files(self, folder: Path) -> tuple[Path, ...]:
        return ()


Radius = Annotated[typed.PositiveLength, Field(description='its radius: "5 mm"')]
Rounding = Annotated[
    typed.PositiveLength, Field(description='radius of its edges: "0.5 mm"')
]


class HalfSpaceTable(ShapeTable):
    makes = contact.HalfSpace
    type: Literal["plane"]


class BallTable(ShapeTable):
    makes = contact.Ball
    type: Literal["sphere"]
    radius: Radius


class RoundedCylinderTable(ShapeTable):
    makes = contact.RoundedCylinder
    type: Literal["cylinder"]
    radius: Radius
    length: typed.PositiveLength = Field(description='its length: "20 mm"')
    rounding: Rounding


class CapsuleTable(ShapeTable):
    makes = contact.Capsule
    type: Literal["capsule"]
    radius: Radius
    length: typed.PositiveLength = Field(
        description='distance of the centres of its ends: "20 mm"'
    )


class RoundedBoxTable(ShapeTable):
    makes = contact.RoundedBox
    type: Literal["box"]
    size: typed.Extent = Field(description='lengths of its sides: "(20, 20, 10) mm"')
    rounding: Rounding


class SurfaceFileTable(ShapeTable):
    type: Literal["surface"]
    file: str = Field(description='a closed surface: "object.stl"')
    length_unit: LengthUnit = Field(description='the length unit of the file: "mm"')

    def shape(self, folder: Path) -> AbstractShape:
        path = folder / self.file
        check_file(path, "surface file")
        if path.suffix.lower() not in SURFACE_FORMATS:
            raise ValueError(
                f"surface file {path} has the extension {path.suffix!r}; expected one "
                f"of {', '.join(SURFACE_FORMATS)}."
            )
        return contact.read_surface(path, length_unit=METRES[self.length_unit])

    def files(self, folder: Path) -> tuple[Path, ...]:
        return (folder / self.file,)


AnyShape = Annotated[ShapeTable, Choice(by_type)]
