"""Selection of nodes and faces by position.

A predicate is any callable that takes points (n, 3) [m] and gives n booleans, so
regions combine by a lambda: `lambda x: box(x) & ~sphere(x)`.
"""

import abc
from collections.abc import Callable

import equinox as eqx
import numpy as np

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.mesh._tet_mesh import TetMesh
from softcal_jax.mesh._topology import boundary_faces

Predicate = Callable[[HostArray], HostArray]

_ROUNDING = 1e-9
"""Default tolerance [m]: far below any cell, far above the rounding of coordinates."""


def _as_vector(vector) -> HostArray:
    return np.asarray(vector, dtype=float)


def _check_vectors(region: "AbstractRegion", *names: str):
    for name in names:
        value = getattr(region, name)
        if value.shape != (3,) or not np.isfinite(value).all():
            raise ValueError(f"{name} must be three finite numbers, got {value}.")


class AbstractRegion(eqx.Module):
    """A part of space with a distance to points."""

    tolerance: eqx.AbstractVar[float]

    @abc.abstractmethod
    def distance(self, points: Float[HostArray, "n 3"]) -> Float[HostArray, " n"]:
        """Compute the distance of points from the region [m], zero inside."""

    def __call__(self, points: Float[HostArray, "n 3"]) -> Bool[HostArray, " n"]:
        """Say which points lie in the region, within its tolerance.

        Args:
            points: Positions [m].
        """
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
        for name in ("lower", "upper"):
            value = getattr(self, name)
            if value.shape != (3,) or np.isnan(value).any():
                raise ValueError(f"{name} must be three numbers, got {value}.")
        if (self.lower > self.upper).any():
            raise ValueError(
                f"the box is crossed: lower {self.lower} exceeds upper {self.upper}."
            )

    def distance(self, points: Float[HostArray, "n 3"]) -> Float[HostArray, " n"]:
        """Compute the distance of points from the box [m], zero inside."""
        return np.linalg.norm(points - np.clip(points, self.lower, self.upper), axis=1)


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
        _check_vectors(self, "point", "normal")
        if not np.linalg.norm(self.normal) > 0:
            raise ValueError("the normal of a plane must not be zero.")

    def distance(self, points: Float[HostArray, "n 3"]) -> Float[HostArray, " n"]:
        """Compute the distance of points from the plane [m]."""
        normal = self.normal / np.linalg.norm(self.normal)
        return np.abs((points - self.point) @ normal)


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
        _check_vectors(self, "centre")
        if not self.radius > 0:
            raise ValueError(f"radius must be positive [m], got {self.radius}.")

    def distance(self, points: Float[HostArray, "n 3"]) -> Float[HostArray, " n"]:
        """Compute the distance of points from the ball [m], zero inside."""
        gap = np.linalg.norm(points - self.centre, axis=1) - self.radius
        return np.maximum(gap, 0.0)


def select_nodes(mesh: TetMesh, where: Predicate) -> Int[HostArray, " n"]:
    """Select the nodes whose position satisfies a predicate.

    Args:
        mesh: The mesh.
        where: `Box`, `Plane`, `Sphere` or any callable from points [m] to booleans.

    Returns:
        Node indices, sorted.

    Raises:
        ValueError: If no node satisfies it, or it does not give one boolean per point.
    """
    nodes = np.flatnonzero(_mask(mesh, where))
    if not nodes.size:
        raise ValueError(f"no node lies in {where}. {_whereabouts(mesh, where)}")
    return nodes.astype(np.int32)


def select_faces(mesh: TetMesh, where: Predicate) -> Int[HostArray, "n n_fn"]:
    """Select the boundary faces whose nodes all satisfy a predicate.

    Args:
        mesh: The mesh.
        where: `Box`, `Plane`, `Sphere` or any callable from points [m] to booleans.

    Returns:
        3 or 6 nodes of each face, normals outwards.

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
    text = f"The mesh spans {lower.tolist()} to {upper.tolist()} m."
    if isinstance(where, AbstractRegion):
        nearest = where.distance(mesh.points).min()
        text += f" The nearest node is {nearest:.3g} m away; check the length unit."
    return text
