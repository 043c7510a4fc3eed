"""Laws as Abaqus and CalculiX know them: a keyword and its constants."""

from typing import NamedTuple

import numpy as np

from softcal_jax import materials
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.equilibrium import Model

NO_TERM = 1e20
"""D_i of an absent term [1/Pa]: CalculiX replaces 0 by a number of its own."""

SMALLEST_D = 1e-10
"""|D_1| below which CalculiX takes a number of its own."""


class InpLaw(NamedTuple):
    """A law in the terms of an input file.

    `keyword` opens it, like "*HYPERELASTIC, YEOH"; constants are in SI. The note says
    how it differs from the law of the model; `oriented` constants refer to the axes of
    the mesh.
    """

    keyword: str
    constants: Float[HostArray, "n_tets n_constants"]
    note: str
    oriented: bool = False


def inp_law(model: Model) -> InpLaw:
    """Convert the law of a model; a ValueError says why neither program has it."""
    keyword, constants, *more = _converted(model.law)
    columns = [np.broadcast_to(np.asarray(c, float), model.n_tets) for c in constants]
    return InpLaw(keyword, np.stack(columns, axis=1), *more)


_GREEN = (
    "*ELASTIC with NLGEOM is linear in the Green strain in CalculiX (St. Venant-"
    "Kirchhoff), and in the logarithmic strain in Abaqus. "
)

_STRETCH = (
    " is linear in the stretch. Rotations may be large, but stresses differ by up to "
    "about 1.5 times the strain: by 15 % where the strain is 10 %."
)

_NEO_HOOKE = (
    "*HYPERELASTIC, NEO HOOKE splits off the change of volume, "
    "U = C10 (J^(-2/3) I1 - 3) + (J - 1)^2 / D1, where NeoHookean has "
    "mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2. They agree to second order in "
    "the strain, and nearly so at any strain where the volume hardly changes."
)

_VOLUME = (
    "The change of volume costs (J - 1)^2 / D1, D1 = 2 / K, in place of "
    "K/4 (J^2 - 1 - 2 ln J): the same to second order."
)


def _converted(law: materials.AbstractLaw) -> tuple:
    """Return keyword, columns of constants, note, and whether they have axes."""
    name = type(law).__name__
    match law:
        case (
            materials.Corotational()
            | materials.ClassicalCorotational()
            | materials.StVenantKirchhoff()
        ):
            same = isinstance(law, materials.StVenantKirchhoff)
            note = "The former is the law of the model." if same else name + _STRETCH
            if isinstance(law.elasticity, materials.Isotropic):
                constants = law.elasticity.E, law.elasticity.nu
                return "*ELASTIC", constants, _GREEN + note, False
            constants = _anisotropic(law.elasticity)
            return "*ELASTIC, TYPE=ANISO", constants, _GREEN + note, True
        case materials.NeoHookean():
            mu = law.E / (2.0 * (1.0 + law.nu))
            bulk = law.E / (3.0 * (1.0 - 2.0 * law.nu))
            return "*HYPERELASTIC, NEO HOOKE", (0.5 * mu, _D(bulk)), _NEO_HOOKE
        case materials.MooneyRivlin():
            constants = law.c10, law.c01, _D(law.bulk_modulus())
            return "*HYPERELASTIC, MOONEY-RIVLIN", constants, _VOLUME
        case materials.Yeoh():
            volume = _D(law.bulk_modulus()), NO_TERM, NO_TERM
            constants = law.c10, law.c20, law.c30, *volume
            return "*HYPERELASTIC, YEOH", constants, _VOLUME
        case materials.Ogden():  # W has 2 mu / alpha^2 there, and mu / alpha here
            terms = law.terms()
            distortion = [c for mu, alpha in terms for c in (0.5 * mu * alpha, alpha)]
            volume = _D(law.bulk_modulus()), *[NO_TERM] * (len(terms) - 1)
            keyword = f"*HYPERELASTIC, OGDEN, N={len(terms)}"
            return keyword, (*distortion, *volume), _VOLUME
    raise ValueError(f"{name} has no counterpart in Abaqus or CalculiX{_without(law)}.")


def _without(law: materials.AbstractLaw) -> str:
    """Say why there is no counterpart, and what to do."""
    if isinstance(law, materials.Gent):
        return (
            ", which have no law that locks in this way; calibrate Yeoh, which "
            "stiffens too, and export that"
        )
    if isinstance(law, materials.FibreReinforced | materials.TransverseHyperelastic):
        return (
            ": their laws with fibres (Holzapfel) are exponential, and CalculiX has "
            "them as user materials alone. For small strains calibrate Corotational "
            "of TransverseIsotropic, and export that"
        )
    return ": it would need a user subroutine (UMAT) there"


def _anisotropic(elasticity: materials.AbstractElasticity) -> list[HostArray]:
    """Return the 21 constants in the order of *ELASTIC, TYPE=ANISO.

    That is the upper triangle by columns, in the order 11, 22, 33, 12, 13, 23.
    """
    order = [0, 1, 2, 5, 4, 3]  # in Voigt's order, that of the entries
    by_rows = [(a, b) for a in range(6) for b in range(a, 6)]
    table = materials.TabulatedElasticity.of(elasticity)
    entries = dict(zip(by_rows, table.entries, strict=True))
    pairs = (sorted((order[i], order[j])) for j in range(6) for i in range(j + 1))
    return [np.asarray(entries[a, b]) for a, b in pairs]


def _D(bulk: Float[Array, "..."]) -> HostArray:
    """Compute D_1 = 2 / K [1/Pa], if CalculiX takes it as it is."""
    D = np.asarray(2.0 / bulk)
    if np.any(D < SMALLEST_D):
        raise ValueError(
            f"D1 = 2 / K would be {D.min():.3g} 1/Pa, and below {SMALLEST_D:g} "
            "CalculiX takes a number of its own: lower Poisson's ratio; 0.499 is "
            "enough for an incompressible rubber."
        )
    return D
