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
    TabulatedElasticity,
    lame,
)
from softcal_jax.materials._fibre import Fibre, frames_along, frames_around
from softcal_jax.materials._fibre_reinforced import FibreReinforced
from softcal_jax.materials._incompressible import Gent, MooneyRivlin, Ogden, Yeoh
from softcal_jax.materials._law import AbstractLaw
from softcal_jax.materials._rubber import NeoHookean
from softcal_jax.materials._sofa import SofaCorotational, SofaRotation
from softcal_jax.materials._transverse import (
    ReducedTransverseIsotropic,
    TransverseIsotropic,
    plane_stiffness,
)
from softcal_jax.materials._transverse_hyperelastic import TransverseHyperelastic

ELASTICITIES: dict[str, type[AbstractElasticity]] = {
    "isotropic": Isotropic,
    "transverse-isotropic": TransverseIsotropic,
    "reduced-transverse-isotropic": ReducedTransverseIsotropic,
}
"""The tensors C of the laws that are linear in a strain, as project files name them."""

LAWS: dict[str, type[AbstractLaw]] = {
    "neo-hookean": NeoHookean,
    "mooney-rivlin": MooneyRivlin,
    "yeoh": Yeoh,
    "ogden": Ogden,
    "gent": Gent,
    "corotational": Corotational,
    "classical-corotational": ClassicalCorotational,
    "st-venant-kirchhoff": StVenantKirchhoff,
    "transverse-hyperelastic": TransverseHyperelastic,
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
    "Gent",
    "Isotropic",
    "MooneyRivlin",
    "NeoHookean",
    "Ogden",
    "PointValues",
    "ReducedTransverseIsotropic",
    "SofaCorotational",
    "SofaRotation",
    "StVenantKirchhoff",
    "TabulatedElasticity",
    "TransverseHyperelastic",
    "TransverseIsotropic",
    "Yeoh",
    "constant",
    "frames_along",
    "frames_around",
    "is_point_values",
    "lame",
    "law_at_points",
    "plane_stiffness",
]
