"""The laws under test, one of each, and states to test them in."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jax import Array
from jaxtyping import Float

from softcal_jax.elements import determinant
from softcal_jax.materials import (
    AbstractLaw,
    ClassicalCorotational,
    Corotational,
    Fibre,
    FibreReinforced,
    Gent,
    Isotropic,
    MooneyRivlin,
    NeoHookean,
    Ogden,
    ReducedTransverseIsotropic,
    StVenantKirchhoff,
    TransverseHyperelastic,
    TransverseIsotropic,
    Yeoh,
)

E, NU = 1.0, 0.3
LAM, MU = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))


class EnergyOnly(AbstractLaw):
    """Law of Cook's membrane, given by its energy alone (deal.II code gallery).

    psi = mu/2 (J^-2/3 I1 - 3) + K/4 (J^2 - 1 - 2 ln J).
    """

    mu: Float[Array, "..."]
    bulk: Float[Array, "..."]

    def energy_density(self, F: Float[Array, "3 3"]) -> Float[Array, ""]:
        J = determinant(F)
        volume = 0.25 * self.bulk * (J**2 - 1.0 - 2.0 * jnp.log(J))
        return 0.5 * self.mu * (J ** (-2 / 3) * jnp.sum(F * F) - 3.0) + volume


ISOTROPIC = {
    "corotational": Corotational(Isotropic(E, NU)),
    "st-venant-kirchhoff": StVenantKirchhoff(Isotropic(E, NU)),
    "neo-hookean": NeoHookean(E, NU),
    "mooney-rivlin": MooneyRivlin(0.35 * MU, 0.15 * MU, NU),
    "yeoh": Yeoh(0.5 * MU, -0.01, 0.003, NU),
    "ogden": Ogden(0.6 * MU, 1.7, nu=NU, mu_2=-0.49 * MU, alpha_2=-2.0),
    "gent": Gent(MU, 40.0, NU),
    "energy-only": EnergyOnly(jnp.asarray(MU), jnp.asarray(LAM + 2 * MU / 3)),
}

# The soft axis is the fibre, as in the paper; moduli of order one.
E_T, E_L, NU_T, NU_TL, MU_L = 1.0, 0.3, 0.26, 0.41, 0.09
FIBRE = Fibre(0.4, 0.2, "xy")
ELASTICITIES = {
    "full": TransverseIsotropic(E_T, E_L, NU_T, NU_TL, MU_L, FIBRE),
    "reduced": ReducedTransverseIsotropic(E_T, E_L, NU, FIBRE),
}
TRANSVERSE = TransverseHyperelastic(E_T, E_L, NU, MU_L, FIBRE)
SMALL_STRAIN = TransverseIsotropic(E_T, E_L, NU, NU, MU_L, FIBRE)

# Each law with the elasticity that is its small-strain limit.
ANISOTROPIC = {
    "corotational full": (Corotational(ELASTICITIES["full"]), ELASTICITIES["full"]),
    "corotational reduced": (
        Corotational(ELASTICITIES["reduced"]),
        ELASTICITIES["reduced"],
    ),
    "st-venant-kirchhoff full": (
        StVenantKirchhoff(ELASTICITIES["full"]),
        ELASTICITIES["full"],
    ),
    "st-venant-kirchhoff reduced": (
        StVenantKirchhoff(ELASTICITIES["reduced"]),
        ELASTICITIES["reduced"],
    ),
    "transverse-hyperelastic": (TRANSVERSE, SMALL_STRAIN),
    "transverse-hyperelastic stiff": (
        TransverseHyperelastic(0.3, 1.0, 0.2, 0.4, Fibre(-1.0, 0.1, "xy")),
        TransverseIsotropic(0.3, 1.0, 0.2, 0.2, 0.4, Fibre(-1.0, 0.1, "xy")),
    ),
}

# Matrices with fibres as stiff as they are, so that both matter to the tolerances.
REINFORCED = {
    "neo-hookean with fibres": FibreReinforced(NeoHookean(E, NU), 2.0, FIBRE),
    "corotational with two families": FibreReinforced(
        Corotational(Isotropic(E, NU)), 2.0, FIBRE, families=2
    ),
    "neo-hookean with threads": FibreReinforced(
        NeoHookean(E, NU), 2.0, FIBRE, families=2, tension_only=True
    ),
}
LAWS = ISOTROPIC | {name: law for name, (law, _) in ANISOTROPIC.items()} | REINFORCED
CLASSICAL = {
    "isotropic": ClassicalCorotational(Isotropic(E, NU)),
    "full": ClassicalCorotational(ELASTICITIES["full"]),
    "reduced": ClassicalCorotational(ELASTICITIES["reduced"]),
}

# Deformation gradients with det F > 0, up to stretches of 1.7 and 0.4.
GRADIENTS = np.asarray(jnp.eye(3)[None] + 0.25 * jr.normal(jr.key(0), (6, 3, 3)))


class At(NamedTuple):
    """What a law says of one deformation gradient."""

    energy: Any
    stress: Any
    tangent: Any


class Derived(NamedTuple):
    """By automatic differentiation of the energy, whatever a law overrides.

    And the stress along a dF and pulled back.
    """

    stress: Any
    tangent: Any
    along: Any
    pulled_back: Any


class Together(NamedTuple):
    """Both pairs that a law may compute at once, and what its table says."""

    energy_and_stress: Any
    stress_and_tangent: Any
    table: At


# One program of each for a law, which all tests share.
@jax.jit
def _at(law, F):
    return At(law.energy_density(F), law.stress(F), law.tangent(F))


@jax.jit
def _derived(law, F, dF, cotangent):
    stress_twice = lambda F: (AbstractLaw.stress(law, F),) * 2
    hessian, stress = jax.jacfwd(stress_twice, has_aux=True)(F)
    _, along = jax.linearize(law.stress, F)
    (pulled_back,) = jax.linear_transpose(along, F)(cotangent)
    return Derived(stress, hessian, along(dF), pulled_back)


@jax.jit
def _together(law, F):
    pairs = law.energy_and_stress(F), law.stress_and_tangent(F)
    return Together(*pairs, _at(law.tabulated(), F))


def at(law, F) -> At:
    """NumPy arrays, as of the others below: tests calculate with them on the host."""
    return jax.tree.map(np.asarray, _at(law, F))


def derived(law, F, dF=GRADIENTS[0], cotangent=GRADIENTS[0]) -> Derived:
    return jax.tree.map(np.asarray, _derived(law, F, dF, cotangent))


def together(law, F) -> Together:
    return jax.tree.map(np.asarray, _together(law, F))


def overriding(*methods: str):
    """Laws with an own form of one of these methods of `AbstractLaw`."""
    has = lambda law, name: getattr(type(law), name) is not getattr(AbstractLaw, name)
    return {k: law for k, law in LAWS.items() if any(has(law, m) for m in methods)}


def energy(law, F):
    return at(law, F).energy


def stress(law, F):
    return at(law, F).stress


def tangent(law, F):
    return at(law, F).tangent


@jax.jit
def _stiffness(elasticity):
    unit = jnp.eye(9).reshape(9, 3, 3)
    return jax.vmap(lambda e: elasticity.stress(0.5 * (e + e.T)))(unit)


def stiffness(elasticity):
    """Tensor C_iJkL of an elasticity, column by column."""
    columns = np.asarray(_stiffness(elasticity)).reshape(3, 3, 3, 3)
    return columns.transpose(2, 3, 0, 1)
