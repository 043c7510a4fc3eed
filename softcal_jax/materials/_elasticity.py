"""Linear elasticity tensors, shared by the laws that are linear in a strain measure."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import ArrayLike

from softcal_jax._typing import Array, Float
from softcal_jax.materials._checks import (
    as_field,
    check_modulus,
    check_poisson_ratio,
)


class AbstractElasticity(eqx.Module):
    """A stiffness tensor C with its minor and major symmetries."""

    @abstractmethod
    def stress(self, strain: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """Stress C : strain for a symmetric strain [Pa]."""


def lame(
    E: Float[ArrayLike, "..."], nu: Float[ArrayLike, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Lame constants (lambda, mu) of Young's modulus and Poisson's ratio [Pa].

    Args:
        E: Young's modulus [Pa].
        nu: Poisson's ratio [-].

    Returns:
        lambda = E nu / ((1 + nu)(1 - 2 nu)) and mu = E / (2 (1 + nu)).
    """
    return (
        jnp.asarray(E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))),
        jnp.asarray(E / (2.0 * (1.0 + nu))),
    )


class Isotropic(AbstractElasticity):
    """Isotropic elasticity: lambda tr(strain) I + 2 mu strain.

    Attributes:
        E: Young's modulus [Pa], one value or one per tet.
        nu: Poisson's ratio [-] in (-1, 0.5), one value or one per tet.
    """

    E: Float[Array, "..."] = eqx.field(converter=as_field)
    nu: Float[Array, "..."] = eqx.field(converter=as_field)

    def __check_init__(self):
        check_modulus("E", self.E)
        check_poisson_ratio("nu", self.nu)

    def stress(self, strain: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """Stress lambda tr(strain) I + 2 mu strain [Pa]."""
        lam, mu = lame(self.E, self.nu)
        return lam * jnp.trace(strain) * jnp.eye(3) + 2.0 * mu * strain
