"""Chambers: closed cavities that a pressure inflates."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.actuators._actuator import AbstractActuator, Kind, RestState
from softcal_jax.actuators._cliques import AbstractPotentialCliques, each_clique
from softcal_jax.actuators._geometry import ActuatorGeometry
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
        nodes: 3 or 6 nodes of each face, its normal out of the body.
        owner: Index of the chamber.
        centre: The point c. Any point gives a closed surface the same volume; one near
            the cavity avoids cancellation [m].
    """

    nodes: Int[Array, "*cliques n_fn"]
    owner: Int[Array, "*cliques"]
    centre: Float[Array, "*cliques 3"]
    curved: ClassVar[bool] = True

    def contribution(self, x: Float[Array, "n_fn 3"]) -> Float[Array, ""]:
        """Compute the volume of the cone from the centre to one face [m3]."""
        arm = x - self.centre[None]
        n_dA, N = vector_areas(arm)
        return -jnp.sum(n_dA * (N @ arm)) / 3.0

    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        """The faces."""
        del x
        return ActuatorGeometry(
            faces=np.asarray(self.nodes), face_owner=np.asarray(self.owner)
        )
