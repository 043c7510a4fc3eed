"""Constitutive laws: energy densities, their stresses and tangents."""

from softcal_jax.materials._elasticity import AbstractElasticity, Isotropic, lame
from softcal_jax.materials._law import AbstractLaw
from softcal_jax.materials._linear import Corotational, StVenantKirchhoff
from softcal_jax.materials._neo_hookean import NeoHookean

__all__ = [
    "AbstractElasticity",
    "AbstractLaw",
    "Corotational",
    "Isotropic",
    "NeoHookean",
    "StVenantKirchhoff",
    "lame",
]
