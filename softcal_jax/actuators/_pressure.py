"""Pressures: in a closed chamber, or following an open surface."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.actuators._actuator import AbstractActuator, Kind, RestState
from softcal_jax.actuators._cliques import (
    AbstractCliques,
    AbstractPotentialCliques,
    ActuatorGeometry,
    draw_faces,
    each_clique,
)
from softcal_jax.actuators._surfaces import check_closed, outward_faces, vector_areas


class Chamber(AbstractActuator):
    """A cavity in the body, under pressure.

    delta_a = V(x) - V(X) is the growth of the enclosed volume since rest [m3].
    lambda_a is the gauge pressure in the cavity [Pa]: positive inflates, negative is
    vacuum.

    Attributes:
        name: Its name.
        surface: Name of the surface group that is the whole wall of the cavity; the
            order of a face's nodes does not matter.
    """

    name: str
    surface: str
    kind: ClassVar[Kind] = Kind("chamber", "Pa", "m3")

    def cliques(self, rest: RestState, owner: int) -> "ChamberFaces":
        """Return the faces of the wall.

        Raises:
            ValueError: If the surface is unknown, open, not on the boundary, or
                encloses the body instead of a cavity.
        """
        faces = outward_faces(rest.mesh, self.surface, self.label)
        check_closed(rest.mesh, faces, self.surface, self.label)
        points = jnp.asarray(rest.points)
        centre = jnp.mean(points[np.unique(faces)], axis=0)
        wall = ChamberFaces(
            jnp.asarray(faces),
            jnp.full(len(faces), owner, faces.dtype),
            jnp.tile(centre, (len(faces), 1)),
        )
        volume = float(jnp.sum(each_clique(ChamberFaces.contribution, wall, points)))
        if not volume > 0.0:
            raise ValueError(
                f"{self.label}: surface {self.surface!r} has the body on its inner "
                f"side (enclosed volume {volume:.3g} m3), expected the wall of a "
                "cavity. A pressure on the body from outside is a SurfacePressure."
            )
        return wall


class ChamberFaces(AbstractPotentialCliques):
    """Faces of the walls of chambers; each adds a cone's volume to delta_a.

    V = -1/3 integral of (x - c) . n dA by the divergence theorem. The normal n points
    out of the body, hence into the cavity, which explains the minus sign.

    Attributes:
        centre: The point c. Any point gives a closed surface the same volume; one near
            the cavity avoids cancellation [m].
    """

    centre: Float[Array, "*cliques 3"]

    def contribution(self, x: Float[Array, "n_fn 3"]) -> Float[Array, ""]:
        """Compute the volume of the cone from the centre to one face [m3]."""
        arm = x - self.centre[None]
        n_dA, N = vector_areas(arm)
        return -jnp.sum(n_dA * (N @ arm)) / 3.0

    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        """Draw the faces."""
        return draw_faces(self)


class SurfacePressure(AbstractActuator):
    """A pressure on a surface of the body that turns and grows with it.

    lambda_a is the pressure [Pa]; if positive it pushes against the outward normal. On
    an open surface there is in general no potential, hence no displacement delta_a, and
    the tangent is not symmetric.

    Attributes:
        name: Its name.
        surface: Name of a surface group on the boundary of the body; the order of a
            face's nodes does not matter.
    """

    name: str
    surface: str
    kind: ClassVar[Kind] = Kind("surface pressure", "Pa", None)

    def cliques(self, rest: RestState, owner: int) -> "PressureFaces":
        """Return the faces of the surface."""
        faces = outward_faces(rest.mesh, self.surface, self.label)
        return PressureFaces(
            jnp.asarray(faces), jnp.full(len(faces), owner, faces.dtype)
        )


class PressureFaces(AbstractCliques):
    """Faces under a following pressure, their normals out of the body."""

    def row(self, x: Float[Array, "n_fn 3"]) -> Float[Array, "n_fn 3"]:
        """Compute consistent forces per pressure, -integral of N n dA [m2]."""
        n_dA, N = vector_areas(x)
        return -N.T @ n_dA

    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        """Draw the faces."""
        return draw_faces(self)
