"""The elasticity of the plugin Anisotropy, as its source computes it."""

import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.materials import (
    AbstractElasticity,
    Fibre,
    ReducedTransverseIsotropic,
    TransverseIsotropic,
    plane_stiffness,
)


class PluginElasticity(AbstractElasticity):
    """Transverse isotropy of `TetrahedronAnisotropicForceField`, not of the textbook.

    Two of its five stiffnesses differ (plugin Anisotropy, commit d36486e of 2026-05):
    the shear modulus along the fibre is that across it, E_t / (2 (1 + nu_t)), whatever
    is given for mu_l; and C13 = E_t g (nu_lt + nu_t nu_tl) with g = 1 / ((1 + nu_t)
    (1 - nu_t - 2 nu_lt nu_tl)), where the inverse of the compliance has nu_t nu_lt in
    the sum. A model for this plugin is therefore calibrated with what it computes.

    Attributes:
        base: The law whose E_t, E_l, ratios and fibre are handed over.
    """

    base: TransverseIsotropic | ReducedTransverseIsotropic

    @property
    def fibre(self) -> Fibre:
        """Direction of the fibre in the rest shape."""
        return self.base.fibre

    def constants(self) -> dict[str, Float[Array, "..."]]:
        """E_t and E_l [Pa], nu_t and nu_tl [-] of the base."""
        E_t, E_l = self.base.E_t, self.base.E_l
        if isinstance(self.base, TransverseIsotropic):
            nu_t, nu_tl = self.base.nu_t, self.base.nu_tl
        else:
            nu_t, nu_tl = self.base.nu, self.base.nu * jnp.sqrt(E_t / E_l)
        return {"E_t": E_t, "E_l": E_l, "nu_t": nu_t, "nu_tl": nu_tl}

    def stress(self, strain: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """Stress C : strain for a symmetric strain [Pa]."""
        E_t, E_l, nu_t, nu_tl = self.constants().values()
        exact = plane_stiffness(E_t, E_l, nu_t, nu_tl)
        nu_lt = nu_tl * E_l / E_t
        C13 = exact.C13 * (nu_lt + nu_t * nu_tl) / (nu_lt + nu_t * nu_lt)
        mu = E_t / (2.0 * (1.0 + nu_t))
        textbook = TransverseIsotropic(E_t, E_l, nu_t, nu_tl, mu, self.fibre)
        # psi gains (C13' - C13) (tr - e) e, with e the strain along the fibre u.
        u = self.fibre.direction()
        along = jnp.sum(u * jnp.sum(strain * u[None, :], axis=1))
        trace = strain[0, 0] + strain[1, 1] + strain[2, 2]
        uu = u[:, None] * u[None, :]
        more = along * (jnp.eye(3) - uu) + (trace - along) * uu
        return textbook.stress(strain) + (C13 - exact.C13) * more
