"""Laws that are linear in a strain measure: corotational and St. Venant-Kirchhoff."""

import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.elements import matmul, rotation, skew, spin, symmetric
from softcal_jax.materials._elasticity import AbstractElasticity
from softcal_jax.materials._law import AbstractLaw


class Corotational(AbstractLaw):
    """Linear law in the stretch of the polar decomposition F = R S.

    psi = 1/2 (S - I) : C : (S - I). With sigma = C : (S - I), the exact gradient is
    P = R (sigma - hat(c)), c = M^-1 axial(sigma S), M = tr(S) I - S; hat(c) vanishes
    for an isotropic C, where this is the 'polar' corotational tet of SOFA. The paper's
    element (Vanneste, Goury, Duriez, RA-L 2022, Sec. IV.A) in its energy-consistent
    form. The tangent follows from the closed-form derivative of R.

    Attributes:
        elasticity: The tensor C, in the axes of the rest shape.
    """

    elasticity: AbstractElasticity

    def energy_density(self, F: Float[Array, "3 3"]) -> Float[Array, ""]:
        """Energy 1/2 (S - I) : C : (S - I) [J/m3]."""
        strain = symmetric(matmul(rotation(F).T, F)) - jnp.eye(3)
        return 0.5 * jnp.sum(strain * self.elasticity.stress(strain))

    def stress(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """First Piola-Kirchhoff stress R (sigma - hat(c)) [Pa]."""
        R = rotation(F)
        S = symmetric(matmul(R.T, F))
        sigma = self.elasticity.stress(S - jnp.eye(3))
        c = spin(S, matmul(sigma, S))
        return matmul(R, sigma - skew(c))


class StVenantKirchhoff(AbstractLaw):
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

    @staticmethod
    def _green_strain(F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        return 0.5 * (matmul(F.T, F) - jnp.eye(3))
