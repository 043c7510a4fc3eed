"""Selection of nodes and faces by name, index or position.

A predicate is any callable that takes points (n, 3) [m] and gives n booleans, so
regions combine by a lambda: `lambda x: box(x) & ~sphere(x)`.
"""

import abc
from collections.abc import Callable

import equinox as eqx
import numpy as np

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax._units import readable, readable_values
from softcal_jax.mesh._tet_mesh import TetMesh
from softcal_jax.mesh._topology import boundary_faces

Predicate = Callable[[HostArray], HostArray]

_ROUNDING = 1e-9
"""Default tolerance [m]: far below any cell, far above the rounding of coordinates."""


def _as_vector(vector) -> HostArray:
    return np.asarray(vector, dtype=float)


class AbstractRegion(eqx.Module):
    """A part of space with a distance to points."""

    tolerance: eqx.AbstractVar[float]

    def _check(self, names: tuple[str, ...], *, infinite: bool = False):
        """Check that attributes are vectors of three numbers."""
        for name in names:
            value = getattr(self, name)
            bad = np.isnan(value) if infinite else ~np.isfinite(value)
            if value.shape != (3,) or bad.any():
                what = "three numbers" if infinite else "three finite numbers"
                raise ValueError(f"{name} must be {what}, got {value}.")

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
        """Compute the distance of points from the box [m], zero inside."""
        return np.linalg.norm(points - np.clip(points, self.lower, self.upper), axis=1)

    def __str__(self) -> str:
        """Describe it, for messages."""
        return f"the box from {_place(self.lower)} to {_place(self.upper)}"


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
        """Compute the distance of points from the plane [m]."""
        normal = self.normal / np.linalg.norm(self.normal)
        return np.abs((points - self.point) @ normal)

    def __str__(self) -> str:
        """Describe it, for messages."""
        normal = ", ".join(f"{x:.4g}" for x in self.normal)
        return f"the plane through {_place(self.point)} across ({normal})"


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
        """Compute the distance of points from the ball [m], zero inside."""
        gap = np.linalg.norm(points - self.centre, axis=1) - self.radius
        return np.maximum(gap, 0.0)

    def __str__(self) -> str:
        """Describe it, for messages."""
        radius = readable(self.radius, "m")
        return f"the sphere of {radius} around {_place(self.centre)}"


def _place(point: Float[HostArray, "3"]) -> str:
    return readable_values(point.tolist(), "m")


def select_nodes(mesh: TetMesh, where: Predicate) -> Int[HostArray, " n"]:
    """Select the nodes whose position satisfies a predicate, sorted.

    Args:
        mesh: The mesh.
        where: `Box`, `Plane`, `Sphere` or any callable from points [m] to booleans.

    Raises:
        ValueError: If no node satisfies it, or it does not give one boolean per point.
    """
    nodes = np.flatnonzero(_mask(mesh, where))
    if not nodes.size:
        raise ValueError(f"no node lies in {where}. {_whereabouts(mesh, where)}")
    return nodes.astype(np.int32)


def select_faces(mesh: TetMesh, where: Predicate) -> Int[HostArray, "n n_fn"]:
    """Select the boundary faces whose nodes all satisfy a predicate, normals outwards.

    Args:
        mesh: The mesh.
        where: `Box`, `Plane`, `Sphere` or any callable from points [m] to booleans.

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
    """Return the indices of the nodes of a group, or check given ones.

    Args:
        mesh: The mesh.
        where: Name of a group, or node indices.
        owner: What acts on the nodes, for messages.

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
    text = f"The mesh spans {_place(lower)} to {_place(upper)}."
    if isinstance(where, AbstractRegion):
        nearest = readable(float(where.distance(mesh.points).min()), "m")
        text += f" The nearest node is {nearest} away; check the length unit."
    return text
