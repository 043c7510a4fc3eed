"""Parts of space by which nodes, faces and tets are chosen."""

import abc

import equinox as eqx
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax._units import readable, readable_values

_ROUNDING = 1e-9
"""Default tolerance [m]: far below any cell, far above the rounding of coordinates."""


def _as_vector(vector) -> HostArray:
    return np.asarray(vector, dtype=float)


class AbstractRegion(Module):
    """A part of space with a distance to points."""

    tolerance: eqx.AbstractVar[float]

    def _check(self, names: tuple[str, ...], *, infinite: bool = False):
        """Check that attributes are vectors of three numbers."""
        for name in names:
            value = getattr(self, name)
            bad = np.isnan(value) if infinite else ~np.isfinite(value)
            if value.shape != (3,) or bad.any():
                what = "numbers" if infinite else "finite numbers"
                raise ValueError(f"{name} must be three {what}, got {value}.")

    @abc.abstractmethod
    def distance(self, points: Float[HostArray, "n 3"]) -> Float[HostArray, " n"]:
        """Compute the distance of points from the region [m], zero inside."""

    def __call__(self, points: Float[HostArray, "n 3"]) -> Bool[HostArray, " n"]:
        """Say which points [m] lie in the region, within its tolerance."""
        return self.distance(points) <= self.tolerance


class Box(AbstractRegion):
    """The points between two corners, sides included.

    Attributes:
        lower: Smallest coordinates [m].
        upper: Largest coordinates [m].
        tolerance: Distance at which a point still counts as inside [m].
    """

    lower: Float[HostArray, "3"] = eqx.field(converter=_as_vector)
    upper: Float[HostArray, "3"] = eqx.field(converter=_as_vector)
    tolerance: float = _ROUNDING

    def __check_init__(self):
        # Infinite sides are allowed: they select half-spaces and slabs.
        self._check(("lower", "upper"), infinite=True)
        if (self.lower > self.upper).any():
            raise ValueError(
                f"the box is crossed: lower {self.lower} exceeds upper {self.upper}."
            )

    def distance(self, points: Float[HostArray, "n 3"]) -> Float[HostArray, " n"]:
        return np.linalg.norm(points - np.clip(points, self.lower, self.upper), axis=1)

    def __str__(self) -> str:
        return f"the box from {place(self.lower)} to {place(self.upper)}"


class Plane(AbstractRegion):
    """The points of a plane.

    Attributes:
        point: A point of the plane [m].
        normal: Its normal, of any length.
        tolerance: Distance at which a point still counts as on it [m].
    """

    point: Float[HostArray, "3"] = eqx.field(converter=_as_vector)
    normal: Float[HostArray, "3"] = eqx.field(converter=_as_vector)
    tolerance: float = _ROUNDING

    def __check_init__(self):
        self._check(("point", "normal"))
        if not np.linalg.norm(self.normal) > 0:
            raise ValueError("the normal of a plane must not be zero.")

    def distance(self, points: Float[HostArray, "n 3"]) -> Float[HostArray, " n"]:
        normal = self.normal / np.linalg.norm(self.normal)
        return np.abs((points - self.point) @ normal)

    def __str__(self) -> str:
        normal = ", ".join(f"{x:.4g}" for x in self.normal)
        return f"the plane through {place(self.point)} across ({normal})"


class Sphere(AbstractRegion):
    """The points of a ball.

    Attributes:
        centre: Its centre [m].
        radius: Its radius [m].
        tolerance: Distance at which a point still counts as inside [m].
    """

    centre: Float[HostArray, "3"] = eqx.field(converter=_as_vector)
    radius: float
    tolerance: float = _ROUNDING

    def __check_init__(self):
        self._check(("centre",))
        if not self.radius > 0:
            raise ValueError(f"radius must be positive [m], got {self.radius}.")

    def distance(self, points: Float[HostArray, "n 3"]) -> Float[HostArray, " n"]:
        gap = np.linalg.norm(points - self.centre, axis=1) - self.radius
        return np.maximum(gap, 0.0)

    def __str__(self) -> str:
        radius = readable(self.radius, "m")
        return f"the sphere of {radius} around {place(self.centre)}"


class AbstractTube(AbstractRegion):
    """The points between two radii about a straight axis, both ends included.

    Attributes:
        start: Middle of one end [m].
        end: Middle of the other end [m].
    """

    start: Float[HostArray, "3"] = eqx.field(converter=_as_vector)
    end: Float[HostArray, "3"] = eqx.field(converter=_as_vector)

    @property
    @abc.abstractmethod
    def radii(self) -> tuple[float, float]:
        """Inner and outer radius [m]."""

    def __check_init__(self):
        self._check(("start", "end"))
        if not np.linalg.norm(self.end - self.start) > 0:
            raise ValueError(
                f"start and end are both at {place(self.start)}; expected the middles "
                "of two ends, which give the direction of the axis."
            )
        inner, outer = self.radii
        if not 0.0 <= inner < outer:
            raise ValueError(
                "the outer radius must be positive, and the inner one zero or more and "
                f"less than the outer one, got {inner} and {outer} m."
            )

    def distance(self, points: Float[HostArray, "n 3"]) -> Float[HostArray, " n"]:
        inner, outer = self.radii
        length = np.linalg.norm(self.end - self.start)
        axis = (self.end - self.start) / length
        along = (points - self.start) @ axis
        radius = np.linalg.norm(points - self.start - along[:, None] * axis, axis=1)
        beyond = np.maximum(np.maximum(-along, along - length), 0.0)
        aside = np.maximum(np.maximum(inner - radius, radius - outer), 0.0)
        return np.hypot(beyond, aside)

    def __str__(self) -> str:
        radii = " to ".join(readable(r, "m") for r in self.radii if r)
        ends = f"from {place(self.start)} to {place(self.end)}"
        return f"the {type(self).__name__.lower()} of radius {radii} {ends}"


class Annulus(AbstractTube):
    """The points between two cylinders about one axis: a tube, or a short one: a ring.

    Attributes:
        inner: Radius of the hole [m].
        outer: Outer radius [m].
        tolerance: Distance at which a point still counts as inside [m].
    """

    inner: float
    outer: float
    tolerance: float = _ROUNDING

    @property
    def radii(self) -> tuple[float, float]:
        return self.inner, self.outer


class Cylinder(AbstractTube):
    """The points within a radius of a straight axis, both ends included.

    Attributes:
        radius: Its radius [m].
        tolerance: Distance at which a point still counts as inside [m].
    """

    radius: float
    tolerance: float = _ROUNDING

    @property
    def radii(self) -> tuple[float, float]:
        return 0.0, self.radius


def place(point: Float[HostArray, "3"]) -> str:
    """Write a position in a readable unit, for messages."""
    return readable_values(point.tolist(), "m")
