"""Ogden rubber, in the principal stretches."""

from typing import Any, NamedTuple

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
    AbstractRubber,
    signed,
)


def _if_any(value: Float[ArrayLike, "..."] | None) -> Constant | None:
    return None if value is None else as_field(value)


def _stiffness(term: str) -> dict[str, Any]:
    return signed(f'stiffness of the {term} term: "600 kPa"')


def _exponent(term: str) -> dict[str, Any]:
    return constant("", f"exponent of the {term} term: 1.3")


class _Term(NamedTuple):
    mu: Constant
    alpha: Constant


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

    def terms(self) -> list[_Term]:
        """Return stiffness and exponent of each term."""
        pairs = (
            (self.mu_1, self.alpha_1),
            (self.mu_2, self.alpha_2),
            (self.mu_3, self.alpha_3),
        )
        return [_Term(m, a) for m, a in pairs if m is not None and a is not None]

    def shear_modulus(self) -> Constant:
        """Shear modulus at small strain, sum of mu_p alpha_p / 2 [Pa]."""
        return 0.5 * sum_of(term.mu * term.alpha for term in self.terms())

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
            own = matmul(F, M) - trace / 3.0 * G
            stress += mu * jnp.exp(-alpha / 3.0 * log_J) * own
        return stress
