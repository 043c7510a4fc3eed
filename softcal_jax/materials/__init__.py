"""Constitutive laws: energy densities, their stresses and tangents."""

from softcal_jax.materials._constants import (
    ANGLE as ANGLE,
    DENSITY as DENSITY,
    POISSON as POISSON,
    UNREMARKABLE as UNREMARKABLE,
    ConstantKind as ConstantKind,
    constant as constant,
)
from softcal_jax.materials._corotational import (
    ClassicalCorotational as ClassicalCorotational,
    Corotational as Corotational,
    SofaCorotational as SofaCorotational,
    SofaRotation as SofaRotation,
)
from softcal_jax.materials._elasticity import (
    AbstractElasticity as AbstractElasticity,
    Isotropic as Isotropic,
    StVenantKirchhoff as StVenantKirchhoff,
    TabulatedElasticity as TabulatedElasticity,
    lame as lame,
)
from softcal_jax.materials._fibre import (
    Fibre as Fibre,
    frames_along as frames_along,
    frames_around as frames_around,
)
from softcal_jax.materials._fibre_reinforced import FibreReinforced as FibreReinforced
from softcal_jax.materials._law import (
    SHARED as SHARED,
    AbstractLaw as AbstractLaw,
    fields_of_tets as fields_of_tets,
    split_law as split_law,
    turned as turned,
    with_arrays as with_arrays,
    youngs_moduli as youngs_moduli,
)
from softcal_jax.materials._ogden import Ogden as Ogden
from softcal_jax.materials._rubber import (
    Gent as Gent,
    MooneyRivlin as MooneyRivlin,
    NeoHookean as NeoHookean,
    Yeoh as Yeoh,
)
from softcal_jax.materials._transverse import (
    ReducedTransverseIsotropic as ReducedTransverseIsotropic,
    TransverseHyperelastic as TransverseHyperelastic,
    TransverseIsotropic as TransverseIsotropic,
    plane_stiffness as plane_stiffness,
)

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
