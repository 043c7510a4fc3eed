"""Mooney-Rivlin rubber."""

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


class MooneyRivlin(AbstractInvariantRubber):
    """Nearly incompressible Mooney-Rivlin law, for stretches up to about two.

        W = c10 (i1 - 3) + c01 (i2 - 3)

    (Mooney, J. Appl. Phys. 11, 1940; Rivlin, Phil. Trans. R. Soc. A 241, 1948), with
    the invariants and the change of volume of `AbstractRubber`. mu = 2 (c10 + c01). A
    bar that keeps its volume carries P = 2 (s - s^-2) (c10 + c01 / s).

    Attributes:
        c10: Half of the stiffness in shear by i1 [Pa].
        c01: Half of the stiffness in shear by i2 [Pa].
        nu: Poisson's ratio at small strain [-] in (0, 0.5).
    """

    c10: Float[Array, "..."] = eqx.field(
        converter=as_field, metadata=signed('first stiffness: "40 kPa"')
    )
    c01: Float[Array, "..."] = eqx.field(
        converter=as_field, metadata=signed('second stiffness: "5 kPa"')
    )
    nu: Float[Array, "..."] = eqx.field(
        converter=as_field, default=INCOMPRESSIBLE, metadata=RUBBER_RATIO
    )

    def shear_modulus(self) -> Float[Array, "..."]:
        """Shear modulus at small strain, 2 (c10 + c01) [Pa]."""
        return 2.0 * (self.c10 + self.c01)

    def distortion(self, i1: Float[Array, ""], i2: Float[Array, ""]) -> Distortion:
        """Compute W = c10 (i1 - 3) + c01 (i2 - 3)."""
        W = self.c10 * (i1 - 3.0) + self.c01 * (i2 - 3.0)
        return Distortion(W, W_1=self.c10, W_2=self.c01)
