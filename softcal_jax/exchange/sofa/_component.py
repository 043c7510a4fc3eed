"""The component of SOFA that computes a law, and how its stress differs."""

from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.exchange import _formats as formats
from softcal_jax.materials import (
    AbstractElasticity,
    AbstractLaw,
    ClassicalCorotational,
    Corotational,
    Fibre,
    Isotropic,
    NeoHookean,
    ReducedTransverseIsotropic,
    SofaCorotational,
    SofaRotation,
    StVenantKirchhoff,
    TransverseIsotropic,
    lame,
    plane_stiffness,
)
from softcal_jax.mesh import TetMesh

SofaRelease = Literal["v25.12", "v26.06"]
"""Releases of SOFA that scenes are written for."""

SofaUnits = Literal["mm-kg-s", "SI"]
"""Unit systems that scenes are usually written in."""

SofaLaw = Literal["same", "corotational"]
"""Whether SOFA gets the counterpart of the law, or SOFA's corotational law."""

ELASTIC = "Sofa.Component.SolidMechanics.FEM.Elastic"
HYPERELASTIC = "Sofa.Component.SolidMechanics.FEM.HyperElastic"


SCALES = {"mm-kg-s": 1e3, "SI": 1.0}
"""Factors of lengths from SI to the units of a scene; SOFA itself has none.

Mass and time are kg and s in all of them. So this is the factor of forces too, and its
inverse that of pressures.
"""


class Component(NamedTuple):
    """A component of a scene, its plugin, and its data in the units of the scene."""

    component: str
    plugin: str
    data: dict[str, Any]


class PluginElasticity(AbstractElasticity):
    """Transverse isotropy of `TetrahedronAnisotropicForceField`, not of the textbook.

    Two of its five stiffnesses differ (plugin Anisotropy, commit d36486e of 2026-05):
    the shear modulus along the fibre is that across it, E_t / (2 (1 + nu_t)), whatever
    is given for mu_l; and C13 = E_t g (nu_lt + nu_t nu_tl) with g = 1 / ((1 + nu_t)
    (1 - nu_t - 2 nu_lt nu_tl)), where the inverse of the compliance has nu_t nu_lt in
    the sum. A model for this plugin is therefore calibrated with its stiffnesses.

    Attributes:
        base: The law whose E_t, E_l, ratios and fibre are handed over.
    """

    base: TransverseIsotropic | ReducedTransverseIsotropic

    @property
    def fibre(self) -> Fibre:
        """Direction of the fibre in the rest shape."""
        return self.base.fibre

    def constants(self) -> tuple[Float[Array, "..."], ...]:
        """E_t and E_l [Pa], nu_t and nu_tl [-] of the base."""
        E_t, E_l = self.base.E_t, self.base.E_l
        if isinstance(self.base, TransverseIsotropic):
            return E_t, E_l, self.base.nu_t, self.base.nu_tl
        return E_t, E_l, self.base.nu, self.base.nu * jnp.sqrt(E_t / E_l)

    def stress(self, strain: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """Stress C : strain for a symmetric strain [Pa]."""
        E_t, E_l, nu_t, nu_tl = self.constants()
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


def law_for_sofa(
    law: AbstractLaw, mesh: TetMesh, *, choice: SofaLaw, rotation: SofaRotation
) -> AbstractLaw:
    """Return the law that SOFA computes in place of another, on a linear mesh.

    Corotational tets turn by `rotation`; with fibres it is "large", that of the plugin.
    A ValueError says why there is no counterpart, and what to do.
    """
    hooke = formats.hooke_of(law)
    linear = isinstance(law, Corotational | ClassicalCorotational)
    if hooke is not None and (linear or choice == "corotational"):
        return SofaCorotational.of_mesh(mesh, hooke, rotation)
    elasticity = getattr(law, "elasticity", None)
    fibres = TransverseIsotropic, ReducedTransverseIsotropic
    if linear and isinstance(elasticity, fibres):
        return SofaCorotational.of_mesh(mesh, PluginElasticity(elasticity), "large")
    if hooke is None or not isinstance(law, NeoHookean | StVenantKirchhoff):
        raise _no_counterpart(law)
    if any(np.ndim(leaf) > 0 for leaf in jax.tree.leaves(law)):
        raise ValueError(
            f"{type(law).__name__} differs from tet to tet here, and the hyperelastic "
            "component of SOFA takes one set of constants for the whole body; take "
            'law="corotational" (--law corotational), whose moduli SOFA takes per tet.'
        )
    return law


def _no_counterpart(law: AbstractLaw) -> ValueError:
    name = formats.law_name(law)
    reason, other = "SOFA has no such law", "a NeoHookean or a Corotational law"
    if hasattr(law, "elasticity"):
        reason = "only the corotational tets of the plugin Anisotropy have fibres"
        other = "a Corotational law"
    elif name in ("MooneyRivlin", "Ogden"):
        reason = "SOFA's has another term for the change of volume, k0/2 (ln J)^2"
    return ValueError(
        f"{name} has no counterpart in SOFA: {reason}: calibrate {other}, and export "
        "that."
    )


def component_of(
    law: AbstractLaw, n_tets: int, release: SofaRelease, scale: float
) -> Component:
    """Write a law from `law_for_sofa` as a component of a scene, with one of `SCALES`.

    A ValueError if the release lacks it, or SOFA would replace a constant by another.
    """
    pressure = 1.0 / scale
    if isinstance(law, SofaCorotational):
        if isinstance(law.elasticity, PluginElasticity):
            return _of_plugin(law.elasticity, n_tets, pressure)
        assert isinstance(law.elasticity, Isotropic)
        data = {
            "youngModulus": _listed(pressure * np.asarray(law.elasticity.E)),
            "poissonRatio": _listed(law.elasticity.nu),
        }
        for nu in data["poissonRatio"]:
            if not 0.0 <= nu < 0.5:
                raise ValueError(
                    f"nu is {nu:g}; SOFA takes a Poisson's ratio in [0, 0.5) and "
                    "replaces others by 0.45, so this law cannot be written."
                )
        if law.rotation == "procrustes":
            if release == "v25.12":
                raise ValueError(
                    'rotation="procrustes" is that of CorotationalFEMForceField, '
                    "which SOFA has since v26.06; take another rotation for v25.12."
                )
            chosen = {"template": "Vec3,Tetrahedron", "rotationMethod": "polar"}
            return Component("CorotationalFEMForceField", ELASTIC, chosen | data)
        method = {"edge": "polar", "large": "large"}[law.rotation]
        return Component("TetrahedronFEMForceField", ELASTIC, {"method": method} | data)
    constants: Any = getattr(law, "elasticity", law)
    lam, mu = lame(constants.E, constants.nu)
    data = {
        "materialName": type(law).__name__,
        "ParameterSet": [pressure * float(c) for c in (mu, lam)],
    }
    return Component("TetrahedronHyperelasticityFEMForceField", HYPERELASTIC, data)


def _of_plugin(elasticity: PluginElasticity, n_tets: int, pressure: float) -> Component:
    each = [np.broadcast_to(value, (n_tets,)) for value in elasticity.constants()]
    E_t, E_l, nu_t, nu_tl = each
    if np.any(nu_tl == 0.0):
        raise ValueError(
            "nu_tl is 0, where the plugin Anisotropy divides by zero; give another one."
        )
    kind = np.full(n_tets, 2.0)  # transverse isotropy
    E_t, E_l = pressure * E_t, pressure * E_l
    parameters = np.stack([kind, E_l, nu_tl, E_t / (2.0 * (1.0 + nu_t))], axis=1)
    u = jnp.broadcast_to(elasticity.fibre.direction().T, (n_tets, 3))
    data = {
        "elasticitySymmetry": "transverseIsotropic",
        "youngModulus": E_t.tolist(),
        "poissonRatio": nu_t.tolist(),
        "anisotropyParameters": parameters.tolist(),
        "anisotropyDirections": np.asarray(u).tolist(),
    }
    return Component("TetrahedronAnisotropicForceField", "Anisotropy", data)


def _listed(values: Any) -> list[float]:
    return np.atleast_1d(np.asarray(values, float)).tolist()
