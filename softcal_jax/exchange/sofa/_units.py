"""Unit systems of a scene; SOFA itself has none."""

from typing import Literal, NamedTuple

from softcal_jax._names import unknown_name

SofaUnits = Literal["mm-kg-s", "SI"]
"""Unit systems that scenes are usually written in."""


class Scale(NamedTuple):
    """Factors from SI to the units of a scene; mass and time keep theirs.

    Attributes:
        length: From metres.
        words: Unit of each quantity, by its name.
    """

    length: float
    words: dict[str, str]

    @property
    def force(self) -> float:
        """From newtons, kg m/s2."""
        return self.length

    @property
    def pressure(self) -> float:
        """From pascals, kg/(m s2)."""
        return 1.0 / self.length

    @property
    def volume(self) -> float:
        """From cubic metres."""
        return self.length**3


_SCALES = {
    "mm-kg-s": Scale(1e3, {"length": "mm", "force": "mN", "pressure": "kPa"}),
    "SI": Scale(1.0, {"length": "m", "force": "N", "pressure": "Pa"}),
}


def scale_of(units: str) -> Scale:
    """Return the factors of a unit system.

    Raises:
        ValueError: If it is unknown.
    """
    if units not in _SCALES:
        raise unknown_name("unit system", units, _SCALES)
    return _SCALES[units]
