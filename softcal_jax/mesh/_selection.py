"""Selection of nodes and faces by name, index or position.

A predicate is any callable that takes points (n, 3) [m] and gives n booleans, so
regions combine by a lambda: `lambda x: box(x) & ~sphere(x)`.
"""

import abc
from collections.abc import Callable

import equinox as eqx
import numpy as np

from softcal_jax._module import Module, key
from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax._units import readable, readable_values
from softcal_jax.mesh._tet_mesh import TetMesh
from softcal_jax.mesh._topology import boundary_faces

_ROUNDING = 1e-9
"""Default tolerance [m]: far below any cell, far above the rounding of coordinates."""


RADIUS = key("m", 'its radius: "5 mm"', "positive")


def _as_vector(vector) -> HostArray:
    return np.asarray(vector, dtype=float)


class AbstractRegion(Module):
    """A part of space with a distance to points.

    Attributes:
        tolerance: Distance at which a point still counts as inside [m].
    """

    tolerance: float = eqx.field(default=_ROUNDING, kw_only=True)

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
    """

    lower: Float[HostArray, "3"] = eqx.field(
        converter=_as_vector, metadata=key("m", 'a corner: "(0, 0, 0) mm"', "any")
    )
    upper: Float[HostArray, "3"] = eqx.field(
        converter=_as_vector, metadata=key("m", 'a corner: "(0, 30, 30) mm"', "any")
    )

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
    """

    point: Float[HostArray, "3"] = eqx.field(
        converter=_as_vector, metadata=key("m", 'a point on the plane: "(0, 0, 0) mm"')
    )
    normal: Float[HostArray, "3"] = eqx.field(
        converter=_as_vector, metadata=key("", 'its direction: "z" or [0, 0, 1]')
    )

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
    """

    centre: Float[HostArray, "3"] = eqx.field(
        converter=_as_vector, metadata=key("m", 'its centre: "(0, 0, 0) mm"')
    )
    radius: float = eqx.field(metadata=RADIUS)

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

    start: Float[HostArray, "3"] = eqx.field(
        converter=_as_vector,
        metadata=key("m", 'the middle of one end: "(0, 0, 0) mm"'),
    )
    end: Float[HostArray, "3"] = eqx.field(
        converter=_as_vector,
        metadata=key("m", 'the middle of the other: "(10, 0, 0) mm"'),
    )

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
    """

    inner: float = eqx.field(
        metadata=key("m", 'the radius of its hole: "4 mm"', "not negative")
    )
    outer: float = eqx.field(metadata=key("m", 'its outer radius: "6 mm"', "positive"))

    @property
    def radii(self) -> tuple[float, float]:
        return self.inner, self.outer


class Cylinder(AbstractTube):
    """The points within a radius of a straight axis, both ends included.

    Attributes:
        radius: Its radius [m].
    """

    radius: float = eqx.field(metadata=RADIUS)

    @property
    def radii(self) -> tuple[float, float]:
        return 0.0, self.radius


REGIONS: dict[str, type[AbstractRegion]] = {
    "box": Box,
    "plane": Plane,
    "sphere": Sphere,
    "cylinder": Cylinder,
    "annulus": Annulus,
}
"""The regions that project files make, as they call them."""


def place(point: Float[HostArray, "3"]) -> str:
    """Write a position in a readable unit, for messages."""
    return readable_values(point.tolist(), "m")


Predicate = Callable[[HostArray], HostArray]
"""A region like `Box`, or any callable from points [m] to booleans."""


def select_nodes(mesh: TetMesh, where: Predicate) -> Int[HostArray, " n"]:
    """Select the nodes whose position satisfies a predicate, sorted.

    Raises:
        ValueError: If no node satisfies it, or it does not give one boolean per point.
    """
    nodes = np.flatnonzero(_mask(mesh, where))
    if not nodes.size:
        raise ValueError(f"no node lies in {where}. {_whereabouts(mesh, where)}")
    return nodes.astype(np.int32)


def select_faces(mesh: TetMesh, where: Predicate) -> Int[HostArray, "n n_fn"]:
    """Select the boundary faces whose nodes all satisfy a predicate, normals outwards.

    Raises:
        ValueError: If no face satisfies it, or it does not give one boolean per point.
    """
    mask = _mask(mesh, where)
    faces = boundary_faces(mesh)
    faces = faces[mask[faces].all(axis=1)]
    if not faces.size:
        raise ValueError(
            f"no boundary face has all its nodes in {where}; {mask.sum()} nodes lie in "
            f"it. {_whereabouts(mesh, where)}"
        )
    return faces


def node_indices(
    mesh: TetMesh, where: str | Int[HostArray, " n"], owner: str
) -> Int[HostArray, " _"]:
    """Return the nodes of a group, or check given ones; errors name their owner.

    Raises:
        ValueError: If the group is unknown, or the indices are no list of integers
            from 0 to the number of nodes.
    """
    if isinstance(where, str):
        try:
            return mesh.nodes(where)
        except ValueError as error:
            raise ValueError(f"{owner}: {error}") from error
    nodes = np.asarray(where)
    if nodes.ndim != 1 or nodes.dtype.kind not in "iu":
        remedy = " (np.flatnonzero turns a mask into indices)" * (nodes.dtype == bool)
        raise ValueError(
            f"{owner} needs the name of a group or a list of integer node indices"
            f"{remedy}, got {nodes.dtype} of shape {nodes.shape}."
        )
    outside = nodes[(nodes < 0) | (nodes >= mesh.n_nodes)]
    if outside.size:
        raise ValueError(
            f"{owner}: node {outside[0]} is not in the mesh, whose nodes are 0 to "
            f"{mesh.n_nodes - 1}."
        )
    return nodes


def _mask(mesh: TetMesh, where: Predicate) -> HostArray:
    mask = np.asarray(where(mesh.points))
    if mask.dtype != bool or mask.shape != (mesh.n_nodes,):
        raise ValueError(
            f"the predicate must give one boolean for each of {mesh.n_nodes} points, "
            f"got {mask.dtype} of shape {mask.shape}."
        )
    return mask


def _whereabouts(mesh: TetMesh, where: Predicate) -> str:
    lower, upper = mesh.points.min(axis=0), mesh.points.max(axis=0)
    text = f"The mesh spans {place(lower)} to {place(upper)}."
    if isinstance(where, AbstractRegion):
        nearest = readable(float(where.distance(mesh.points).min()), "m")
        text += f" The nearest node is {nearest} away; check the length unit."
    return text


_DEPTH = 0.01
"""Depth of a face of the box around a body, over its size there [-]."""


def box_faces(mesh: TetMesh) -> dict[str, Int[HostArray, " n"]]:
    """Return the nodes on the six faces of the box around a body, by words for each."""
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    near = lambda k, end: np.abs(mesh.points[:, k] - end[k]) <= _DEPTH * (high - low)[k]
    return {
        f"the face of {which} {axis}": np.flatnonzero(near(k, end))
        for which, end in (("least", low), ("largest", high))
        for k, axis in enumerate("xyz")
    }
