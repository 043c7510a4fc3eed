"""Constitutive laws: energy densities, their stresses and tangents."""

from softcal_jax.materials._constants import (
    PointValues,
    constant,
    is_point_values,
    law_at_points,
)
from softcal_jax.materials._corotational import ClassicalCorotational, Corotational
from softcal_jax.materials._elasticity import (
    AbstractElasticity,
    Isotropic,
    StVenantKirchhoff,
    lame,
)
from softcal_jax.materials._fibre_reinforced import FibreReinforced
from softcal_jax.materials._law import AbstractLaw
from softcal_jax.materials._neo_hookean import NeoHookean
from softcal_jax.materials._transverse import (
    Fibre,
    ReducedTransverseIsotropic,
    TransverseIsotropic,
)

ELASTICITIES: dict[str, type[AbstractElasticity]] = {
    "isotropic": Isotropic,
    "transverse-isotropic": TransverseIsotropic,
    "reduced-transverse-isotropic": ReducedTransverseIsotropic,
}
"""The tensors C of the laws that are linear in a strain, as project files name them."""

LAWS: dict[str, type[AbstractLaw]] = {
    "neo-hookean": NeoHookean,
    "corotational": Corotational,
    "classical-corotational": ClassicalCorotational,
    "st-venant-kirchhoff": StVenantKirchhoff,
    "fibre-reinforced": FibreReinforced,
}
"""The laws, as project files name them."""

__all__ = [
    "ELASTICITIES",
    "LAWS",
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
    "constant",
    "is_point_values",
    "lame",
    "law_at_points",
]
