"""Linear elasticity tensors, and laws that are linear in a strain measure."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float
from softcal_jax.elements import matmul
from softcal_jax.materials._constants import (
    MODULUS,
    RATIO,
    Constant,
    as_field,
    check_constants,
)
from softcal_jax.materials._law import AbstractLaw, paired, turned

_UNIT = np.eye(9).reshape(3, 3, 3, 3)
_SYMMETRIC_UNIT = 0.5 * (_UNIT + _UNIT.transpose(1, 0, 2, 3))

_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
"""Voigt's order of the entries of a symmetric tensor."""

_VOIGT = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # index of an entry in that order

_UPPER = np.zeros((6, 6), int)
_UPPER[np.triu_indices(6)] = _UPPER.T[np.triu_indices(6)] = np.arange(21)
"""Index of an entry of the 6x6 matrix in its upper triangle, row by row."""


class AbstractElasticity(Module):
    """A stiffness tensor C with its minor and major symmetries."""

    def __check_init__(self):
        check_constants(self)

    @abstractmethod
    def stress(self, strain: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """Stress C : strain for a symmetric strain [Pa]."""

    def tensor(self) -> Float[Array, "3 3 3 3"]:
        """The tensor C_MJNL [Pa]."""
        return jax.vmap(jax.vmap(self.stress))(jnp.asarray(_SYMMETRIC_UNIT))

    def tabulated(self) -> "AbstractElasticity":
        """Compute the entries once, if that takes long.

        Fields may be those of a whole body: one value, or one per tet.
        """
        return self


class TabulatedElasticity(AbstractElasticity):
    """A stiffness tensor by its entries.

    Attributes:
        entries: Upper triangle of Voigt's 6x6 matrix by rows, in the order 11, 22, 33,
            23, 13, 12 [Pa].
    """

    entries: tuple[Any, ...]

    @classmethod
    def of(cls, elasticity: AbstractElasticity) -> "TabulatedElasticity":
        """Compute the entries of an elasticity with scalar constants in each tet."""
        leaves, tree = jax.tree.flatten(elasticity)

        def entries(*constants):
            C = jax.tree.unflatten(tree, constants).tensor()
            return tuple(
                C[*_PAIRS[a], *_PAIRS[b]] for a in range(6) for b in range(a, 6)
            )

        fields = jnp.broadcast_arrays(*leaves)
        shape = fields[0].shape
        table = jax.vmap(entries)(*(field.ravel() for field in fields))
        return cls(tuple(entry.reshape(shape) for entry in table))

    def stress(self, strain: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        e = [strain[i, j] * (1.0 if i == j else 2.0) for i, j in _PAIRS]
        C = self.entries
        s = [sum(C[_UPPER[a, b]] * e[b] for b in range(6)) for a in range(6)]
        return jnp.stack([jnp.stack([s[a] for a in row]) for row in _VOIGT])

    def tensor(self) -> Float[Array, "3 3 3 3"]:
        indices = _UPPER[_VOIGT[:, :, None, None], _VOIGT[None, None]].ravel()
        return jnp.stack([self.entries[i] for i in indices]).reshape(3, 3, 3, 3)


def lame(
    E: Float[ArrayLike, "..."], nu: Float[ArrayLike, "..."]
) -> tuple[Constant, Constant]:
    """Convert Young's modulus and Poisson's ratio to Lame constants (lambda, mu) [Pa].

    lambda = E nu / ((1 + nu)(1 - 2 nu)) and mu = E / (2 (1 + nu)).
    """
    lam = E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    return jnp.asarray(lam), jnp.asarray(E / (2.0 * (1.0 + nu)))


class Isotropic(AbstractElasticity):
    """Isotropic elasticity: lambda tr(strain) I + 2 mu strain.

    Attributes:
        E: Young's modulus [Pa], one value or one per tet.
        nu: Poisson's ratio [-] in (-1, 0.5), one value or one per tet.
    """

    E: Constant = eqx.field(converter=as_field, metadata=MODULUS)
    nu: Constant = eqx.field(converter=as_field, metadata=RATIO)

    def stress(self, strain: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        lam, mu = lame(self.E, self.nu)
        return lam * jnp.trace(strain) * jnp.eye(3) + 2.0 * mu * strain


class AbstractLinearLaw(AbstractLaw):
    """A law that is linear in a strain measure.

    Attributes:
        elasticity: The tensor C, in the axes of the rest shape.
    """

    elasticity: AbstractElasticity

    @abstractmethod
    def strain(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """Strain that the stress C : strain is linear in [-]."""

    def energy_density(self, F: Float[Array, "3 3"]) -> Float[Array, ""]:
        """Energy 1/2 strain : C : strain [J/m3]."""
        strain = self.strain(F)
        return 0.5 * jnp.sum(strain * self.elasticity.stress(strain))

    def tabulated(self) -> "AbstractLaw":
        """Compute the entries of the tensor C once."""
        table = self.elasticity.tabulated()
        return eqx.tree_at(lambda law: law.elasticity, self, table)


class StVenantKirchhoff(AbstractLinearLaw):
    """Linear law in the Green strain E = (F^T F - I) / 2: psi = 1/2 E : C : E.

    Softens under compression: a bar is unstable below the stretch 1/sqrt(3). Good for
    large rotation at small strain. `elasticity` is C in the axes of the rest shape.
    """

    def strain(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """Green strain (F^T F - I) / 2 [-]."""
        return 0.5 * (matmul(F.T, F) - jnp.eye(3))

    def stress(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """First Piola-Kirchhoff stress F (C : E) [Pa]."""
        return matmul(F, self.elasticity.stress(self.strain(F)))

    def tangent(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3 3 3"]:
        """Tangent delta_ik T_JL + F_iM C_MJNL F_kN with T = C : E [Pa]."""
        T = self.elasticity.stress(self.strain(F))
        return turned(self.elasticity.tensor(), F) + paired(jnp.eye(3), T)
