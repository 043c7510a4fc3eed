"""Direction of a fibre in the rest shape, one for the body or one per tet."""

from types import ModuleType
from typing import Any, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._module import Module, if_any
from softcal_jax._text import check_known
from softcal_jax._typing import Array, Float, HostArray, Vector
from softcal_jax._units import readable_values
from softcal_jax.materials._constants import (
    Constant,
    as_components,
    as_field,
    check_constants,
    constant,
)

Plane = Literal["xy", "xz", "yz"]

_ON_AXIS = 1e-9
"""Distance from an axis that counts as none, over that of the farthest point [-]."""


class Fibre(Module):
    """Axis of a fibre in the rest shape, by its angles.

    u = cos(phi) (cos(theta) a + sin(theta) b) + sin(phi) n, with a and b the axes that
    `plane` names, in this order, and n the third axis (not a x b: for "xz" n is +y).
    The paper (Vanneste, Goury, Duriez, RA-L 2022, Sec. IV.A) has phi = 0. Laws depend
    on u u^T only, so u and -u mean the same material.

    The axes are those of the mesh, or local ones in each tet: `Fibre.along`,
    `Fibre.helix` and `Fibre.of` make these, and theta turns the fibre from there.

    Attributes:
        theta: Angle from a towards b [rad], one value or one per tet.
        phi: Elevation out of the plane towards n [rad], one value or one per tet.
        plane: The print plane: "xy", "xz" or "yz".
        frame: Local axes, a 3x3 matrix per tet whose rows are unit vectors, kept as
            nine fields; None for the axes of the mesh [-].
    """

    theta: Constant = eqx.field(
        converter=as_field,
        metadata=constant("rad", 'angle of the fibre in its print plane: "20 deg"'),
    )
    phi: Constant = eqx.field(
        converter=as_field,
        default=0.0,
        metadata=constant("rad", 'angle of the fibre out of its plane: "10 deg"'),
    )
    plane: Plane = eqx.field(static=True, default="xz", metadata={"key": "print_plane"})
    frame: tuple[Constant, ...] | None = eqx.field(
        converter=if_any(as_components), default=None, metadata={"key": "directions"}
    )

    def __check_init__(self):
        check_known("plane", get_args(Plane), self.plane)
        check_constants(self)

    @classmethod
    def along(cls, axis: Vector, theta: Float[ArrayLike, "..."] = 0.0) -> "Fibre":
        """Fibres along one axis [-], of any length above zero."""
        return cls(theta, frame=frames_along(np.asarray(axis, float)[None])[0])

    @classmethod
    def helix(
        cls,
        theta: Float[ArrayLike, "..."],
        centroids: Float[HostArray, "n_tets 3"],
        axis: Vector,
        through: Vector = (0.0, 0.0, 0.0),
    ) -> "Fibre":
        """Fibres wound around an axis through a point, at the angle theta from it.

        Hoops have theta = pi / 2. Directions are taken at `centroids`, usually
        `TetMesh.centroids` [m].

        Raises:
            ValueError: If a centroid lies on the axis.
        """
        return cls(theta, frame=frames_around(centroids, axis, through))

    @classmethod
    def of(
        cls, vectors: Float[HostArray, "n_tets 3"], theta: Float[ArrayLike, "..."] = 0.0
    ) -> "Fibre":
        """Fibres along one vector per tet [-], of any length above zero."""
        return cls(theta, frame=frames_along(vectors))

    def direction(self) -> Float[Array, "3 ..."]:
        """Unit vector u along the fibre [-], for each tet where it differs."""
        return self._direction(jnp)

    def of_tets(self, n_tets: int) -> Float[HostArray, "n_tets 3"]:
        """Compute `direction` of each tet by NumPy, so that nothing is compiled [-]."""
        return np.broadcast_to(np.transpose(self._direction(np)), (n_tets, 3))

    def _direction(self, xp: ModuleType) -> Any:
        a, b = ("xyz".index(letter) for letter in self.plane)
        parts = {
            a: xp.cos(self.phi) * xp.cos(self.theta),
            b: xp.cos(self.phi) * xp.sin(self.theta),
            3 - a - b: xp.sin(self.phi) * xp.ones_like(self.theta),
        }
        x, y, z = (parts[axis] for axis in range(3))
        if self.frame is None:
            return xp.stack([x, y, z])
        axes = xp.stack(self.frame).reshape(3, 3, *np.shape(self.frame[0]))
        return x * axes[0] + y * axes[1] + z * axes[2]

    def mirrored(self) -> "Fibre":
        """The fibre at -theta."""
        return eqx.tree_at(lambda fibre: fibre.theta, self, -self.theta)


def frames_along(vectors: Float[HostArray, "n 3"]) -> Float[HostArray, "n 3 3"]:
    """Build local axes, the first along a vector and the others arbitrary.

    Raises:
        ValueError: If a vector is zero or not finite; the text names its index.
    """
    vectors = np.asarray(vectors, float)
    length = np.linalg.norm(vectors, axis=1)
    bad = np.flatnonzero(~((length > 0.0) & np.isfinite(length)))
    if bad.size:
        raise ValueError(
            f"the fibre direction {vectors[bad[0]].tolist()} with index {bad[0]} has "
            "no finite length above zero; give a vector along the fibre there."
        )
    x = vectors / length[:, None]
    # The axis of the mesh that is farthest from x.
    other = np.eye(3)[np.argmin(np.abs(x), axis=1)]
    y = np.cross(other, x)
    y /= np.linalg.norm(y, axis=1)[:, None]
    return np.stack([x, y, np.cross(x, y)], axis=1)


def frames_around(
    points: Float[HostArray, "n 3"], axis: Vector, through: Vector
) -> Float[HostArray, "n 3 3"]:
    """Build local axes along an axis, away from it and around it (hoop).

    Raises:
        ValueError: If the axis is zero or a point lies on it; the text names the point.
    """
    along = frames_along(np.asarray(axis, float)[None])[0, 0]
    away = np.asarray(points, float) - np.asarray(through, float)
    away = away - (away @ along)[:, None] * along
    radius = np.linalg.norm(away, axis=1)
    bad = np.flatnonzero(~(radius > _ON_AXIS * np.max(radius, initial=1e-300)))
    if bad.size:
        where = readable_values(np.asarray(points, float)[bad[0]].tolist(), "m")
        raise ValueError(
            f"{bad.size} of {len(radius)} tets have their centroid on the axis, where "
            f"there is no direction around it (index {bad[0]}, at {where}): move "
            "the axis, or give these tets directions of their own."
        )
    radial = away / radius[:, None]
    x = np.broadcast_to(along, radial.shape)
    return np.stack([x, radial, np.cross(x, radial)], axis=1)
