"""Nearly incompressible rubbers: Mooney-Rivlin, Yeoh, Gent and Ogden."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import ArrayLike

from softcal_jax._typing import Array, Float
from softcal_jax.elements import cofactor, determinant, matmul, sum_of
from softcal_jax.materials._constants import Constant, as_field, constant
from softcal_jax.materials._powers import power, trace_of_power
from softcal_jax.materials._rubber import (
    INCOMPRESSIBLE,
    RUBBER_RATIO,
    AbstractInvariantRubber,
    AbstractRubber,
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
        return 2.0 * (self.c10 + self.c01)

    def distortion(self, i1: Float[Array, ""], i2: Float[Array, ""]) -> Distortion:
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
        return 2.0 * self.c10

    def distortion(self, i1: Float[Array, ""], i2: Float[Array, ""]) -> Distortion:
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
        """Compute W; NaN from the limit on, and so are its derivatives."""
        del i2
        used = (i1 - 3.0) / self.J_m
        # As a factor: the derivative of the logarithm is a number beyond the limit too.
        used = used * jnp.where(used < 1.0, 1.0, jnp.nan)
        room = 1.0 - used
        W_1 = 0.5 * self.mu / room
        return Distortion(
            -0.5 * self.mu * self.J_m * jnp.log1p(-used),
            W_1=W_1,
            W_11=W_1 / (room * self.J_m),
        )


def _if_any(value: Float[ArrayLike, "..."] | None) -> Constant | None:
    return None if value is None else as_field(value)


def _stiffness(term: str) -> dict[str, Any]:
    return signed(f'stiffness of the {term} term: "600 kPa"')


def _exponent(term: str) -> dict[str, Any]:
    return constant("", f"exponent of the {term} term: 1.3")


class Ogden(AbstractRubber):
    """Nearly incompressible Ogden law of one to three terms.

        W = sum_p mu_p / alpha_p (s_1^alpha_p + s_2^alpha_p + s_3^alpha_p - 3)

    in the principal stretches s_i of F_iso (Ogden, Proc. R. Soc. A 326, 1972), with the
    change of volume of `AbstractRubber`. mu = sum_p mu_p alpha_p / 2. (Some programs
    write 2 mu_p / alpha_p^2 for mu_p / alpha_p.) A bar that keeps its volume carries
    P = sum_p mu_p (s^(alpha_p - 1) - s^(-alpha_p / 2 - 1)).

    With C = F^T F, s_i^alpha is the eigenvalue of J^(-alpha/3) C^(alpha/2), so that
    P = sum_p mu_p J^(-alpha/3) (F C^(alpha/2 - 1) - tr(C^(alpha/2)) / 3 F^-T): powers
    of a tensor, whose derivatives are finite and exact where stretches coincide too.

    Attributes:
        mu_1: Stiffness of the first term [Pa]; mu_p alpha_p is usually positive.
        alpha_1: Its exponent [-], not zero.
        mu_2: Stiffness of the second term [Pa]; None without one.
        alpha_2: Its exponent [-].
        mu_3: Stiffness of the third term [Pa]; None without one.
        alpha_3: Its exponent [-].
        nu: Poisson's ratio at small strain [-] in (0, 0.5).
    """

    mu_1: Constant = eqx.field(converter=as_field, metadata=_stiffness("first"))
    alpha_1: Constant = eqx.field(converter=as_field, metadata=_exponent("first"))
    mu_2: Constant | None = eqx.field(
        converter=_if_any, default=None, metadata=_stiffness("second")
    )
    alpha_2: Constant | None = eqx.field(
        converter=_if_any, default=None, metadata=_exponent("second")
    )
    mu_3: Constant | None = eqx.field(
        converter=_if_any, default=None, metadata=_stiffness("third")
    )
    alpha_3: Constant | None = eqx.field(
        converter=_if_any, default=None, metadata=_exponent("third")
    )
    nu: Constant = eqx.field(
        converter=as_field, default=INCOMPRESSIBLE, metadata=RUBBER_RATIO
    )

    def __check_init__(self):
        for p in (2, 3):
            mu, alpha = getattr(self, f"mu_{p}"), getattr(self, f"alpha_{p}")
            if (mu is None) != (alpha is None):
                given = f"alpha_{p}" if mu is None else f"mu_{p}"
                raise ValueError(
                    f"term {p} has {given} alone; give mu_{p} and alpha_{p}, or "
                    "neither."
                )

    def terms(self) -> list[tuple[Constant, Constant]]:
        """Return stiffness and exponent of each term."""
        pairs = (
            (self.mu_1, self.alpha_1),
            (self.mu_2, self.alpha_2),
            (self.mu_3, self.alpha_3),
        )
        return [(m, a) for m, a in pairs if m is not None and a is not None]

    def shear_modulus(self) -> Constant:
        return 0.5 * sum_of(mu * alpha for mu, alpha in self.terms())

    def energy_density(self, F: Float[Array, "3 3"]) -> Float[Array, ""]:
        J, C = determinant(F), matmul(F.T, F)
        log_J = jnp.log(J)
        distortion = sum_of(
            mu
            / alpha
            * (jnp.exp(-alpha / 3.0 * log_J) * trace_of_power(C, 0.5 * alpha) - 3.0)
            for mu, alpha in self.terms()
        )
        return distortion + self.volume_energy(J)

    def stress(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """First Piola-Kirchhoff stress, term by term [Pa]."""
        J, C = determinant(F), matmul(F.T, F)
        G, log_J = cofactor(F) / J, jnp.log(J)
        stress = self.volume_stress(J) * G
        for mu, alpha in self.terms():
            M = power(C, 0.5 * alpha - 1.0)
            trace = jnp.sum(M * C)  # tr C^(alpha/2)
            term = matmul(F, M) - trace / 3.0 * G
            stress += mu * jnp.exp(-alpha / 3.0 * log_J) * term
        return stress
