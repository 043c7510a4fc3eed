"""Points that were measured, or are to go, farther away than a robot reaches."""

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from softcal_jax._module import one_line
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable_values
from softcal_jax.configurations._effector_arrays import EffectorRecord

FAR = 3.0
"""Distance over the size of the robot from which a point is hardly meant so [-]."""


class FarPoint(NamedTuple):
    """A point, its distance from its place at rest, and the size of the robot [m]."""

    name: str
    distance: float
    size: float

    __repr__ = one_line

    def __str__(self) -> str:
        """Write the end of a sentence on the point."""
        return (
            f"{readable_values([self.distance], 'm')} from its place at rest, "
            f"{self.distance / self.size:.3g} times the size of the robot "
            f"({readable_values([self.size], 'm')}): check the unit of length and the "
            "frame."
        )


def motions(records: Iterable[EffectorRecord]) -> dict[str, Float[HostArray, " k"]]:
    """Return how far each point was measured from its place at rest, by name [m]."""
    points = [own for own in records if own.quantity == "point" and own.seen.any()]
    return {own.name: own.error(own.at_rest) for own in points}


def farthest(
    moved: Mapping[str, Float[HostArray, " k"]], size: float
) -> FarPoint | None:
    """Return the point that moved farthest, if that is farther than is plausible."""
    points = [FarPoint(name, math.hypot(*u), size) for name, u in moved.items()]
    far = max(points, key=lambda point: point.distance, default=None)
    return far if far is not None and far.distance > FAR * size else None
