"""Yeoh rubber."""

import equinox as eqx

from softcal_jax._typing import Array, Float
from softcal_jax.materials._constants import as_field
from softcal_jax.materials._rubber import (
    INCOMPRESSIBLE,
    RUBBER_RATIO,
    AbstractInvariantRubber,
    Distortion,
    signed,
)


class Yeoh(AbstractInvariantRubber):
    """Nearly incompressible Yeoh law: stiffens again at large stretch.

        W = c10 (i1 - 3) + c20 (i1 - 3)^2 + c30 (i1 - 3)^3

    (Yeoh, Rubber Chem. Technol. 66, 1993), with the invariant and the change of volume
    of `AbstractRubber`. mu = 2 c10. A bar that keeps its volume carries
    P = 2 (s - s^-2) (c10 + 2 c20 (i1 - 3) + 3 c30 (i1 - 3)^2), i1 = s^2 + 2 / s.

    Attributes:
        c10: Half of the shear modulus at small strain [Pa].
        c20: Softening (negative) at medium stretch [Pa].
        c30: Stiffening at large stretch [Pa].
        nu: Poisson's ratio at small strain [-] in (0, 0.5).
    """

    c10: Float[Array, "..."] = eqx.field(
        converter=as_field, metadata=signed('first stiffness: "40 kPa"')
    )
    c20: Float[Array, "..."] = eqx.field(
        converter=as_field, metadata=signed('second stiffness: "-300 Pa"')
    )
    c30: Float[Array, "..."] = eqx.field(
        converter=as_field, metadata=signed('third stiffness: "10 Pa"')
    )
    nu: Float[Array, "..."] = eqx.field(
        converter=as_field, default=INCOMPRESSIBLE, metadata=RUBBER_RATIO
    )

    def shear_modulus(self) -> Float[Array, "..."]:
        """Shear modulus at small strain, 2 c10 [Pa]."""
        return 2.0 * self.c10

    def distortion(self, i1: Float[Array, ""], i2: Float[Array, ""]) -> Distortion:
        """Compute W, a polynomial in i1 - 3."""
        del i2
        x = i1 - 3.0
        return Distortion(
            ((self.c30 * x + self.c20) * x + self.c10) * x,
            W_1=(3.0 * self.c30 * x + 2.0 * self.c20) * x + self.c10,
            W_11=6.0 * self.c30 * x + 2.0 * self.c20,
        )
