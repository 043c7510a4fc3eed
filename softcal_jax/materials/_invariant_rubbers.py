"""Rubbers in the invariants of the distortion: Mooney-Rivlin, Yeoh and Gent."""

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.materials._constants import Constant, as_field, constant
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

    c10: Constant = eqx.field(
        converter=as_field, metadata=signed('first stiffness: "40 kPa"')
    )
    c01: Constant = eqx.field(
        converter=as_field, metadata=signed('second stiffness: "5 kPa"')
    )
    nu: Constant = eqx.field(
        converter=as_field, default=INCOMPRESSIBLE, metadata=RUBBER_RATIO
    )

    def shear_modulus(self) -> Constant:
        """Shear modulus at small strain, 2 (c10 + c01) [Pa]."""
        return 2.0 * (self.c10 + self.c01)

    def distortion(self, i1: Float[Array, ""], i2: Float[Array, ""]) -> Distortion:
        """Compute W = c10 (i1 - 3) + c01 (i2 - 3)."""
        W = self.c10 * (i1 - 3.0) + self.c01 * (i2 - 3.0)
        return Distortion(W, W_1=self.c10, W_2=self.c01)


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

    c10: Constant = eqx.field(
        converter=as_field, metadata=signed('first stiffness: "40 kPa"')
    )
    c20: Constant = eqx.field(
        converter=as_field, metadata=signed('second stiffness: "-300 Pa"')
    )
    c30: Constant = eqx.field(
        converter=as_field, metadata=signed('third stiffness: "10 Pa"')
    )
    nu: Constant = eqx.field(
        converter=as_field, default=INCOMPRESSIBLE, metadata=RUBBER_RATIO
    )

    def shear_modulus(self) -> Constant:
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

    mu: Constant = eqx.field(
        converter=as_field, metadata=constant("Pa", 'shear modulus: "90 kPa"')
    )
    J_m: Constant = eqx.field(
        converter=as_field,
        metadata=constant("", "limit of i1 - 3: 80", within=(0.0, jnp.inf)),
    )
    nu: Constant = eqx.field(
        converter=as_field, default=INCOMPRESSIBLE, metadata=RUBBER_RATIO
    )

    def shear_modulus(self) -> Constant:
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
