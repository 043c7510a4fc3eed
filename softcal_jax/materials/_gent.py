"""Gent rubber, whose chains can be stretched so far and no further."""

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.materials._constants import (
    as_field,
    constant,
)
from softcal_jax.materials._rubber import (
    INCOMPRESSIBLE,
    RUBBER_RATIO,
    AbstractInvariantRubber,
    Distortion,
)


class Gent(AbstractInvariantRubber):
    """Nearly incompressible Gent law, which locks at a finite stretch.

        W = -mu J_m / 2 ln(1 - (i1 - 3) / J_m)

    (Gent, Rubber Chem. Technol. 69, 1996), with the invariant and the change of volume
    of `AbstractRubber`. A bar that keeps its volume carries
    P = mu (s - s^-2) J_m / (J_m - (i1 - 3)), i1 = s^2 + 2 / s. Not defined for
    i1 >= 3 + J_m: there it returns NaN, as for an inverted tet, so that the solver
    steps back; where no shape below the limit meets what is imposed, there is no
    equilibrium.

    Attributes:
        mu: Shear modulus at small strain [Pa].
        J_m: Limit of i1 - 3, where the chains are straight [-].
        nu: Poisson's ratio at small strain [-] in (0, 0.5).
    """

    mu: Float[Array, "..."] = eqx.field(
        converter=as_field, metadata=constant("Pa", 'shear modulus: "90 kPa"')
    )
    J_m: Float[Array, "..."] = eqx.field(
        converter=as_field,
        metadata=constant("", "limit of i1 - 3: 80", within=(0.0, jnp.inf)),
    )
    nu: Float[Array, "..."] = eqx.field(
        converter=as_field, default=INCOMPRESSIBLE, metadata=RUBBER_RATIO
    )

    def shear_modulus(self) -> Float[Array, "..."]:
        """Shear modulus at small strain [Pa]."""
        return self.mu

    def distortion(self, i1: Float[Array, ""], i2: Float[Array, ""]) -> Distortion:
        """Compute W; NaN from the limit on."""
        del i2
        used = (i1 - 3.0) / self.J_m
        room = jnp.where(used < 1.0, 1.0 - used, jnp.nan)
        W_1 = 0.5 * self.mu / room
        return Distortion(
            -0.5 * self.mu * self.J_m * jnp.log1p(-used),
            W_1=W_1,
            W_11=W_1 / (room * self.J_m),
        )
