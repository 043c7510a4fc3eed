"""The law that is linear in the Green strain."""

import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.elements import matmul
from softcal_jax.materials._elasticity import AbstractElasticity
from softcal_jax.materials._law import AbstractLinearLaw
from softcal_jax.materials._products import paired, turned


class StVenantKirchhoff(AbstractLinearLaw):
    """Linear law in the Green strain E = (F^T F - I) / 2: psi = 1/2 E : C : E.

    Softens under compression: a bar is unstable below the stretch 1/sqrt(3). Good for
    large rotation at small strain.

    Attributes:
        elasticity: The tensor C, in the axes of the rest shape.
    """

    elasticity: AbstractElasticity

    def energy_density(self, F: Float[Array, "3 3"]) -> Float[Array, ""]:
        """Energy 1/2 E : C : E [J/m3]."""
        strain = self._green_strain(F)
        return 0.5 * jnp.sum(strain * self.elasticity.stress(strain))

    def stress(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """First Piola-Kirchhoff stress F (C : E) [Pa]."""
        return matmul(F, self.elasticity.stress(self._green_strain(F)))

    def tangent(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3 3 3"]:
        """Tangent delta_ik T_JL + F_iM C_MJNL F_kN with T = C : E [Pa]."""
        T = self.elasticity.stress(self._green_strain(F))
        return turned(self.elasticity.tensor(), F) + paired(jnp.eye(3), T)

    @staticmethod
    def _green_strain(F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        return 0.5 * (matmul(F.T, F) - jnp.eye(3))
