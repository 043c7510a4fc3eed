"""What every constitutive law offers, and the products that make its tangent."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.tree_util import GetAttrKey, SequenceKey

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float
from softcal_jax.elements import sum_of
from softcal_jax.materials._constants import ACROSS, ALONG, MODULUS, check_constants
from softcal_jax.materials._fibre import Fibre

SHARED = {"shared": True}
"""Metadata of a field that all tets of a model share, like the weights of a network."""

Matrix = Float[Array, "3 3"]
Tensor = Float[Array, "3 3 3 3"]


def outer(X: Matrix, Y: Matrix) -> Tensor:
    """Multiply X_iJ Y_kL."""
    return X[:, :, None, None] * Y[None, None]


def crossed(X: Matrix, Y: Matrix) -> Tensor:
    """Multiply X_iL Y_kJ."""
    return X[:, None, None, :] * Y.T[None, :, :, None]


def paired(X: Matrix, Y: Matrix) -> Tensor:
    """Multiply X_ik Y_JL."""
    return X[:, None, :, None] * Y[None, :, None, :]


def turned(C: Tensor, G: Matrix) -> Tensor:
    """Transform the first index of each pair, G_iM C_MJNL G_kN."""
    # Barriers stop XLA from recomputing C and `half` for each entry of the result.
    C = jax.lax.optimization_barrier(C)
    half = sum_of(C[:, :, None, N, :] * G[None, None, :, N, None] for N in range(3))
    half = jax.lax.optimization_barrier(half)
    return sum_of(G[:, M, None, None, None] * half[None, M] for M in range(3))


class AbstractLaw(Module):
    """A hyperelastic law; a new one is a subclass with its `energy_density`.

    Stress and tangent follow by automatic differentiation. A law with closed forms
    overrides `stress` or `tangent`; they are tested against the energy.

    Methods see one material point, at which a field of the law is one value. A model
    may hold one scalar for the whole body, or one value (a scalar or a tensor) per tet.
    A field with the metadata `SHARED` is handed to all points as it is, whatever its
    shape: weights of a network, coefficients of a series. Write 3x3 algebra with
    `softcal_jax.elements` (`determinant`, `matmul`, ...), which vectorises;
    `jnp.linalg` works too but is slower.

    Example:
        A user's own law::

            class Polynomial(AbstractLaw):
                c1: Array = eqx.field(metadata=constant("Pa", 'stiffness: "30 kPa"'))
                c2: Array = eqx.field(metadata=constant("Pa", 'hardening: "1 kPa"'))
                bulk: Array = eqx.field(metadata=constant("Pa", 'bulk: "2 MPa"'))

                def energy_density(self, F):
                    J = determinant(F)
                    I1 = J ** (-2 / 3) * jnp.sum(F * F)
                    return (self.c1 * (I1 - 3) + self.c2 * (I1 - 3) ** 2
                            + self.bulk / 2 * (J - 1) ** 2)

    Project files read the metadata, and name a law of an installed package by its entry
    point in the group "softcal_jax.laws"; without them a law serves Python only. What a
    constant is follows from them, whatever its name: a Poisson's ratio has
    `kind=POISSON`, so that its error is considered where it is not fitted, and that
    nearly incompressible tets do not lock.

    Attributes:
        conservative: Whether `stress` is the gradient of `energy_density`, so that a
            potential exists, moments balance and the tangent is symmetric.
    """

    conservative: ClassVar[bool] = True

    def __check_init__(self):
        check_constants(self)

    @abstractmethod
    def energy_density(self, F: Matrix) -> Float[Array, ""]:
        """Strain energy per reference volume, psi(F) [J/m3]."""

    def stress(self, F: Matrix) -> Matrix:
        """First Piola-Kirchhoff stress P = d psi / d F [Pa]."""
        return jax.grad(self.energy_density)(F)

    def tangent(self, F: Matrix) -> Tensor:
        """Tangent A_iJkL = d P_iJ / d F_kL [Pa]."""
        return jax.jacfwd(self.stress)(F)

    def energy_and_stress(self, F: Matrix) -> tuple[Float[Array, ""], Matrix]:
        """Compute energy [J/m3] and stress [Pa]; override it if they share work."""
        return self.energy_density(F), self.stress(F)

    def stress_and_tangent(self, F: Matrix) -> tuple[Matrix, Tensor]:
        """Compute stress and tangent [Pa]; override it if they share work."""
        return self.stress(F), self.tangent(F)

    def tabulated(self) -> "AbstractLaw":
        """Compute what does not depend on F once, as for all steps of an equilibrium.

        Fields may be those of a whole body: one value, or one per tet.
        """
        return self

    def fibres(self) -> tuple[Fibre, ...]:
        """Return its fibres, one for each family; empty for an isotropic law."""
        leaves = jax.tree.leaves(self, is_leaf=lambda leaf: isinstance(leaf, Fibre))
        return tuple(leaf for leaf in leaves if isinstance(leaf, Fibre))

    def parts(self) -> tuple["AbstractLaw", "AbstractLaw | None"]:
        """Split into what resists a change of volume, and the rest, if there is any.

        Mean dilatation replaces the volume ratio of the first part alone. What the rest
        resists, like the stretch of a fibre, does not depend on the volume: with the
        mean volume ratio a tet could stretch its fibres at one point and shorten them
        at another at hardly any cost (Helfenstein, Jabareen, Mazza and Govindjee, Int.
        J. Solids Structures 47, 2010).
        """
        return self, None


def split_law(law: AbstractLaw) -> tuple[AbstractLaw, AbstractLaw]:
    """Split into the fields that tets have values of, and what they share.

    Each part has None for the fields of the other; `equinox.combine` joins them again.
    """
    of_tets = lambda path, leaf: hasattr(leaf, "ndim") and not _is_shared(law, path)
    return eqx.partition(law, jax.tree_util.tree_map_with_path(of_tets, law))


def with_arrays(law: AbstractLaw) -> AbstractLaw:
    """Return a law with arrays in place of the numbers of Python among its fields."""
    number = lambda leaf: isinstance(leaf, int | float) and not isinstance(leaf, bool)
    converted = lambda path, leaf: (
        jnp.asarray(leaf, float) if number(leaf) and not _is_shared(law, path) else leaf
    )
    return jax.tree_util.tree_map_with_path(converted, law)


def fields_of_tets(law: AbstractLaw) -> list[tuple[str, Any, Mapping[str, Any]]]:
    """List the fields that tets have values of, and what they are declared to be.

    Each has its path, like ".fibre.theta", and value. Names mean nothing: see
    `constant` for the declaration.
    """
    leaves = jax.tree_util.tree_leaves_with_path(split_law(law)[0])
    name = jax.tree_util.keystr
    return [(name(path), leaf, _declared(law, path)[-1]) for path, leaf in leaves]


def youngs_moduli(law: AbstractLaw) -> list[tuple[str, Any]]:
    """List moduli along and across a fibre, or the isotropic one: paths and values."""
    fields, kinds = fields_of_tets(law), [of.items() for of in (ALONG, ACROSS, MODULUS)]
    return [(p, leaf) for k in kinds for p, leaf, of in fields if k <= of.items()]


def _is_shared(law: AbstractLaw, path: Sequence[Any]) -> bool:
    """Tell whether a field on the way to a leaf of a law is one that tets share."""
    return any(declared.get("shared") for declared in _declared(law, path))


def _declared(node: Any, path: Sequence[Any]) -> list[Mapping[str, Any]]:
    """List what the fields on the way to a leaf of a law are declared to be."""
    declared = []
    for key in path:
        known = getattr(node, "__dataclass_fields__", {})
        name = getattr(key, "name", "")
        declared.append(known[name].metadata if name in known else {})
        if isinstance(key, GetAttrKey):
            node = getattr(node, name)
        else:
            node = node[key.idx] if isinstance(key, SequenceKey) else None
    return declared
