"""Base of all entries of a parameter space: one method that applies their values."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import equinox as eqx

from softcal_jax._typing import Array, Float

if TYPE_CHECKING:  # a parameter is an entry itself
    from softcal_jax.fields._parameters import Parameter


class AbstractEntry(eqx.Module):
    """One or several unknowns, and what they set in a model and its configurations.

    Sensitivities follow from `apply` by autodiff. A new kind of parameter is a line in
    `fields._setup.QUANTITIES` if it sets an array that the model or the configurations
    already have, otherwise a subclass.
    """

    @property
    @abstractmethod
    def parameters(self) -> tuple["Parameter", ...]:
        """The unknowns that it adds."""

    @property
    @abstractmethod
    def fields(self) -> tuple[str, ...]:
        """Fields of the law, or the density, if it sets these and nothing else.

        One pass over the tets then gives the forces of all unknowns of a field. Empty
        for an entry that sets anything else; `check_parameters` verifies this.
        """

    @property
    @abstractmethod
    def tet_group(self) -> str | None:
        """Tet group in which it sets fields; None for the whole body."""

    @property
    @abstractmethod
    def label(self) -> str:
        """Its name in messages."""

    @abstractmethod
    def apply(
        self, model: Any, configuration: Any, values: Mapping[str, Float[Array, ""]]
    ) -> tuple[Any, Any]:
        """Set the values of its unknowns; traceable and differentiable.

        Args:
            model: Anything with `law`, `density`, `mesh` and `mechanism`.
            configuration: Arrays of one configuration; None where only the model is
                wanted.
            values: Values of all parameters by name, in SI units.

        Returns:
            Model and configuration, changed where the entry sets something.
        """

    @abstractmethod
    def check(self, model: Any) -> None:
        """Raise ValueError unless the model has what the entry sets."""

    @abstractmethod
    def renamed(
        self, points: Mapping[str, str], names: Mapping[str, str]
    ) -> "AbstractEntry":
        """Return the same entry with other names.

        Args:
            points: New names of control points.
            names: New names of parameters.
        """
