"""The component of SOFA that computes a law, and what it computes otherwise."""

from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
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
    is_point_values,
    lame,
    plane_stiffness,
)
from softcal_jax.mesh import TetMesh

SofaRelease = Literal["v25.12", "v26.06"]
"""Releases of SOFA that scenes are written for."""

SofaUnits = Literal["mm-kg-s", "SI"]
"""Unit systems that scenes are usually written in."""

SofaLaw = Literal["same", "corotational"]
"""Whether SOFA gets the counterpart of the law, or its corotational one."""

ELASTIC = "Sofa.Component.SolidMechanics.FEM.Elastic"
HYPERELASTIC = "Sofa.Component.SolidMechanics.FEM.HyperElastic"


class Scale(NamedTuple):
    """Factors from SI to the units of a scene, whose mass and time are kg and s."""

    length: float
    words: dict[str, str]
    """Unit of each quantity, by its name."""

    @property
    def force(self) -> float:
        """From newtons, kg m/s2."""
        return self.length

    @property
    def pressure(self) -> float:
        """From pascals, kg/(m s2)."""
        return 1.0 / self.length

    @property
    def volume(self) -> float:
        """From cubic metres."""
        return self.length**3


SCALES = {
    "mm-kg-s": Scale(1e3, {"length": "mm", "force": "mN", "pressure": "kPa"}),
    "SI": Scale(1.0, {"length": "m", "force": "N", "pressure": "Pa"}),
}
"""Unit systems by name; SOFA itself has none."""


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


def law_for_sofa(
    law: AbstractLaw, mesh: TetMesh, *, choice: SofaLaw, rotation: SofaRotation
) -> AbstractLaw:
    """Return the law that SOFA computes in place of another, on a linear mesh.

    Corotational tets turn by `rotation`; with fibres it is "large", that of the plugin.
    A ValueError says why there is no counterpart, and what to do.
    """
    leaves = jax.tree.leaves(law, is_leaf=is_point_values)
    if any(map(is_point_values, leaves)):
        raise ValueError(
            "the law has constants that differ within a tet, and SOFA knows one per "
            'tet; take sampling = "centroids" for the parameters, the default.'
        )
    elasticity = getattr(law, "elasticity", None)
    if isinstance(law, Corotational | ClassicalCorotational):
        if isinstance(elasticity, Isotropic):
            return SofaCorotational.of_mesh(mesh, elasticity, rotation)
        if isinstance(elasticity, TransverseIsotropic | ReducedTransverseIsotropic):
            of_plugin = PluginElasticity(elasticity)
            return SofaCorotational.of_mesh(mesh, of_plugin, "large")
    if choice == "corotational":
        for constants in (law, elasticity):
            if isinstance(constants, NeoHookean | Isotropic):
                hooke = Isotropic(constants.E, constants.nu)
                return SofaCorotational.of_mesh(mesh, hooke, rotation)
    of_body = isinstance(law, NeoHookean) or (
        isinstance(law, StVenantKirchhoff) and isinstance(elasticity, Isotropic)
    )
    if not of_body:
        raise _no_counterpart(law)
    if any(np.ndim(leaf) > 0 for leaf in leaves):
        raise ValueError(
            f"{type(law).__name__} differs from tet to tet here, and the hyperelastic "
            "component of SOFA takes one set of constants for the whole body; take "
            'law="corotational" (--law corotational), whose moduli SOFA takes per tet.'
        )
    return law


def _no_counterpart(law: AbstractLaw) -> ValueError:
    name, elasticity = type(law).__name__, getattr(law, "elasticity", None)
    if isinstance(elasticity, AbstractElasticity):
        name += f" with {type(elasticity).__name__}"
        reason = (
            "SOFA has fibres only in the corotational tets of the plugin Anisotropy: "
            "calibrate a Corotational law"
        )
    else:
        reason = "SOFA has no such law"
        if name in ("MooneyRivlin", "Ogden"):
            reason = "SOFA's has another term for the change of volume, k0/2 (ln J)^2"
        reason += ": calibrate a NeoHookean or a Corotational law"
    return ValueError(f"{name} has no counterpart in SOFA: {reason}, and export that.")


def component_of(
    law: AbstractLaw, n_tets: int, release: SofaRelease, scale: Scale
) -> Component:
    """Write a law from `law_for_sofa` as a component of a scene.

    Not where the release lacks it, or SOFA would replace a constant by another.
    """
    if isinstance(law, SofaCorotational):
        if isinstance(law.elasticity, PluginElasticity):
            return _of_plugin(law.elasticity, n_tets, scale)
        assert isinstance(law.elasticity, Isotropic)
        data = {
            "youngModulus": _listed(scale.pressure * np.asarray(law.elasticity.E)),
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
        "ParameterSet": [scale.pressure * float(c) for c in (mu, lam)],
    }
    return Component("TetrahedronHyperelasticityFEMForceField", HYPERELASTIC, data)


def _of_plugin(elasticity: PluginElasticity, n_tets: int, scale: Scale) -> Component:
    constants = {
        name: np.broadcast_to(np.asarray(value), (n_tets,))
        for name, value in elasticity.constants().items()
    }
    if np.any(constants["nu_tl"] == 0.0):
        raise ValueError(
            "nu_tl is 0, where the plugin Anisotropy divides by zero; give another one."
        )
    kind = np.full(n_tets, 2.0)  # transverse isotropy
    E_t, E_l = (scale.pressure * constants[name] for name in ("E_t", "E_l"))
    nu_t, nu_tl = constants["nu_t"], constants["nu_tl"]
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
