"""Compressible neo-Hookean rubber."""

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.elements import cofactor, determinant
from softcal_jax.materials._constants import MODULUS, RATIO, as_field, check_constants
from softcal_jax.materials._elasticity import lame
from softcal_jax.materials._law import AbstractLaw
from softcal_jax.materials._products import crossed, outer, paired


class NeoHookean(AbstractLaw):
    """Compressible neo-Hookean law.

    psi = mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2, I1 = F : F, J = det F
    (Bonet and Wood, Nonlinear Continuum Mechanics for Finite Element Analysis,
    Eq. 6.27). Not defined for J <= 0, where it returns NaN and the solver steps back.

    Attributes:
        E: Young's modulus at small strain [Pa], one value or one per tet.
        nu: Poisson's ratio at small strain [-] in (-1, 0.5), one value or one per tet.
    """

    E: Float[Array, "..."] = eqx.field(converter=as_field, metadata=MODULUS)
    nu: Float[Array, "..."] = eqx.field(converter=as_field, metadata=RATIO)

    def __check_init__(self):
        check_constants(self)

    def energy_density(self, F: Float[Array, "3 3"]) -> Float[Array, ""]:
        """Energy mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2 [J/m3]."""
        lam, mu = lame(self.E, self.nu)
        log_J = jnp.log(determinant(F))
        return mu * (0.5 * (jnp.sum(F * F) - 3.0) - log_J) + 0.5 * lam * log_J**2

    def stress(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """First Piola-Kirchhoff stress mu (F - F^-T) + lambda ln J F^-T [Pa]."""
        lam, mu = lame(self.E, self.nu)
        J = determinant(F)
        return mu * F + (lam * jnp.log(J) - mu) * (cofactor(F) / J)

    def tangent(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3 3 3"]:
        """Tangent mu I + lambda G(x)G + (mu - lambda ln J) G_iL G_kJ, G = F^-T [Pa]."""
        lam, mu = lame(self.E, self.nu)
        J = determinant(F)
        G = cofactor(F) / J
        across = (mu - lam * jnp.log(J)) * crossed(G, G)
        return mu * paired(jnp.eye(3), jnp.eye(3)) + lam * outer(G, G) + across
