"""Laws that are linear in a strain measure; that of Green."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.elements import matmul
from softcal_jax.materials._elasticity import AbstractElasticity
from softcal_jax.materials._law import AbstractLaw
from softcal_jax.materials._products import paired, turned


class AbstractLinearLaw(AbstractLaw):
    """A law that is linear in a strain measure.

    Attributes:
        elasticity: The tensor C, in the axes of the rest shape.
    """

    elasticity: AbstractElasticity

    @abstractmethod
    def strain(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """Strain that the stress C : strain is linear in [-]."""

    def energy_density(self, F: Float[Array, "3 3"]) -> Float[Array, ""]:
        """Energy 1/2 strain : C : strain [J/m3]."""
        strain = self.strain(F)
        return 0.5 * jnp.sum(strain * self.elasticity.stress(strain))

    def tabulated(self) -> "AbstractLaw":
        """Compute the entries of the tensor C once."""
        return eqx.tree_at(
            lambda law: law.elasticity, self, self.elasticity.tabulated()
        )


class StVenantKirchhoff(AbstractLinearLaw):
    """Linear law in the Green strain E = (F^T F - I) / 2: psi = 1/2 E : C : E.

    Softens under compression: a bar is unstable below the stretch 1/sqrt(3). Good for
    large rotation at small strain. `elasticity` is C in the axes of the rest shape.
    """

    def strain(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """Green strain (F^T F - I) / 2 [-]."""
        return 0.5 * (matmul(F.T, F) - jnp.eye(3))

    def stress(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """First Piola-Kirchhoff stress F (C : E) [Pa]."""
        return matmul(F, self.elasticity.stress(self.strain(F)))

    def tangent(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3 3 3"]:
        """Tangent delta_ik T_JL + F_iM C_MJNL F_kN with T = C : E [Pa]."""
        T = self.elasticity.stress(self.strain(F))
        return turned(self.elasticity.tensor(), F) + paired(jnp.eye(3), T)
