"""Direction of the fibre at a material point."""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.materials._constants import as_field, check_constants, constant

Plane = Literal["xy", "xz", "yz"]


class Fibre(eqx.Module):
    """Axis of transverse isotropy in the rest shape, by its angles.

    u = cos(phi) (cos(theta) a + sin(theta) b) + sin(phi) n, with a and b the axes that
    `plane` names, in this order, and n the third axis (not a x b: for "xz" n is +y).
    The paper (Vanneste, Goury, Duriez, RA-L 2022, Sec. IV.A) has phi = 0. Laws depend
    on u u^T only, so u and -u mean the same material.

    Attributes:
        theta: Angle from a towards b [rad], one value or one per tet.
        phi: Elevation out of the plane towards n [rad], one value or one per tet.
        plane: The print plane: "xy", "xz" or "yz".
    """

    theta: Float[Array, "..."] = eqx.field(
        converter=as_field,
        metadata=constant("rad", 'angle of the fibre in its print plane: "20 deg"'),
    )
    phi: Float[Array, "..."] = eqx.field(
        converter=as_field,
        default=0.0,
        metadata=constant("rad", 'angle of the fibre out of its plane: "10 deg"'),
    )
    plane: Plane = eqx.field(static=True, default="xz", metadata={"key": "print_plane"})

    def __check_init__(self):
        if self.plane not in ("xy", "xz", "yz"):
            raise ValueError(
                f'plane must be "xy", "xz" or "yz", got {self.plane!r}; '
                "theta counts from its first axis towards its second."
            )
        check_constants(self)

    def direction(self) -> Float[Array, "3"]:
        """Unit vector u along the fibre [-]."""
        a, b = ("xyz".index(letter) for letter in self.plane)
        parts = {
            a: jnp.cos(self.phi) * jnp.cos(self.theta),
            b: jnp.cos(self.phi) * jnp.sin(self.theta),
            3 - a - b: jnp.sin(self.phi) * jnp.ones_like(self.theta),
        }
        return jnp.stack([parts[axis] for axis in range(3)])
