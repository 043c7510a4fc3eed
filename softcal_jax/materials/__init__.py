"""Constitutive laws: energy densities, their stresses and tangents."""

from softcal_jax.materials._corotational import ClassicalCorotational, Corotational
from softcal_jax.materials._elasticity import AbstractElasticity, Isotropic, lame
from softcal_jax.materials._fibre import Fibre
from softcal_jax.materials._fibre_reinforced import FibreReinforced
from softcal_jax.materials._kirchhoff import StVenantKirchhoff
from softcal_jax.materials._law import AbstractLaw
from softcal_jax.materials._neo_hookean import NeoHookean
from softcal_jax.materials._point_values import (
    PointValues,
    is_point_values,
    law_at_points,
)
from softcal_jax.materials._transverse import (
    ReducedTransverseIsotropic,
    TransverseIsotropic,
)

__all__ = [
    "AbstractElasticity",
    "AbstractLaw",
    "ClassicalCorotational",
    "Corotational",
    "Fibre",
    "FibreReinforced",
    "Isotropic",
    "NeoHookean",
    "PointValues",
    "ReducedTransverseIsotropic",
    "StVenantKirchhoff",
    "TransverseIsotropic",
    "is_point_values",
    "lame",
    "law_at_points",
]
