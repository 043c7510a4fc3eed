"""Pressure that follows an open surface: a force without a potential."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.actuators._actuator import AbstractActuator, Kind, RestState
from softcal_jax.actuators._cliques import AbstractCliques
from softcal_jax.actuators._geometry import ActuatorGeometry
from softcal_jax.actuators._surfaces import outward_faces, vector_areas


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
        """Return the faces of the surface.

        Raises:
            ValueError: If the surface is unknown or not on the boundary.
        """
        faces = outward_faces(rest.mesh, self.surface, self.label)
        return PressureFaces(
            jnp.asarray(faces), jnp.full(len(faces), owner, faces.dtype)
        )


class PressureFaces(AbstractCliques):
    """Faces under a following pressure.

    Attributes:
        nodes: 3 or 6 nodes of each face, its normal out of the body.
        owner: Index of the surface pressure.
    """

    nodes: Int[Array, "*cliques n_fn"]
    owner: Int[Array, "*cliques"]
    curved: ClassVar[bool] = True

    def row(self, x: Float[Array, "n_fn 3"]) -> Float[Array, "n_fn 3"]:
        """Compute consistent forces per pressure, -integral of N n dA [m2]."""
        n_dA, N = vector_areas(x)
        return -N.T @ n_dA

    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        """The faces."""
        del x
        return ActuatorGeometry(
            faces=np.asarray(self.nodes), face_owner=np.asarray(self.owner)
        )
