"""Constants of a material as keys of a project file."""

from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator

from softcal_jax.materials import constant
from softcal_jax.project._quantities import Size, dimension_of, scalar
from softcal_jax.project._table import Number


class Constant(NamedTuple):
    """A constant of a material, as its law declares it.

    Attributes:
        unit: SI unit, as results name it.
        words: What it is, with an example.
        within: Open interval in which the bounds of a parameter must lie.
        may_vanish: Whether the constant itself may be 0 too.
    """

    unit: str
    words: str
    within: tuple[float, float]
    may_vanish: bool

    @property
    def is_angle(self) -> bool:
        """Whether it is the angle of an axis."""
        return self.unit == "rad"

    @property
    def scale(self) -> Literal["log", "linear"]:
        """Default scale: moduli are positive, so that their steps are ratios."""
        signed = self.within[0] < 0.0
        return "linear" if self.unit in ("", "rad") or signed else "log"

    @property
    def type(self) -> Any:
        """Pydantic type of its key in a table."""
        if not self.unit:
            return Number
        parse = scalar(dimension_of(self.unit), self._size)
        return Annotated[float, BeforeValidator(parse)]

    @property
    def _size(self) -> Size:
        if self.within[0] < 0.0:
            return "finite"
        return "not negative" if self.may_vanish else "positive"


DENSITY = Constant(**constant("kg/m3", 'mass density: "1070 kg/m^3"', may_vanish=True))
