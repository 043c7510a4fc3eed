"""Entries of errors that are considered and never calibrated.

Only their derivative at zero counts, where they change nothing.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.fields._model_fields import find_field, set_field
from softcal_jax.fields._parameters import AbstractEntry, Parameter, _number
from softcal_jax.fields._setup import QUANTITIES, Quantity, entry_index
from softcal_jax.materials import PointValues, is_point_values


class AbstractError(AbstractEntry):
    """One unknown about zero, counted in its standard deviation.

    Attributes:
        name: Its name.
        std: Its standard deviation, in SI units or relative.
    """

    name: eqx.AbstractVar[str]
    std: eqx.AbstractVar[Float[Array, ""]]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its unknown."""
        unknown = Parameter(
            self.name, "", 0.0, -1.0, 1.0, scale="linear", S=1.0, prior_std=1.0
        )
        return (unknown,)

    def size(self, values: Mapping[str, Float[Array, ""]]) -> Float[Array, ""]:
        """Return the error, in SI units or relative."""
        return values[self.name] * self.std

    def renamed(
        self, points: Mapping[str, str], names: Mapping[str, str]
    ) -> "AbstractError":
        """Return the same error with another name."""
        del points
        return replace(self, name=names[self.name])


class FieldError(AbstractError):
    """An error of a field of the law, or of the density.

    Attributes:
        name: Its name.
        std: Its standard deviation.
        field: The field, as `find_field` finds it.
        share: Error of each tet per unit of the unknown; 0 where it is calibrated.
        relative: Whether the error is relative to the value.
    """

    name: str = eqx.field(static=True)
    std: Float[Array, ""] = eqx.field(converter=_number)
    field: str = eqx.field(static=True)
    share: Float[Array, " n_tets"]
    relative: bool = eqx.field(static=True, default=False)

    @property
    def fields(self) -> tuple[str, ...]:
        """The field."""
        return (self.field,)

    def check(self, model: Any) -> None:
        """Raise ValueError unless the model has the field."""
        find_field(model, self.field)

    def apply(
        self, model: Any, configuration: Any, values: Mapping[str, Float[Array, ""]]
    ) -> tuple[Any, Any]:
        """Add the error to the field."""
        old = find_field(model, self.field)(model)
        error = self.size(values) * self.share
        if is_point_values(old):
            error = error[:, None]
            own = old.values + error * (old.values if self.relative else 1.0)
            return set_field(model, self.field, PointValues(own)), configuration
        per_tet = jnp.broadcast_to(old, self.share.shape)
        own = per_tet + error * (per_tet if self.relative else 1.0)
        return set_field(model, self.field, own), configuration


class SetupError(AbstractError):
    """An error of the setup, the loads or a recording, beside its present value.

    Attributes:
        name: Its name.
        std: Its standard deviation; that of a factor is relative.
        kind: One of `QUANTITIES`.
        of: What it belongs to, like the motor; empty where it belongs to nothing.
        axis: Component of a quantity that has several; empty otherwise.
    """

    name: str = eqx.field(static=True)
    std: Float[Array, ""] = eqx.field(converter=_number)
    kind: str = eqx.field(static=True)
    of: str = eqx.field(static=True, default="")
    axis: str = eqx.field(static=True, default="")

    @property
    def quantity(self) -> Quantity:
        """What it changes."""
        return QUANTITIES[self.kind]

    def check(self, model: Any) -> None:
        """Raise ValueError unless the model has the motor or the body."""
        if not self.quantity.of_configuration:
            entry_index(self, model)

    def apply(
        self, model: Any, configuration: Any, values: Mapping[str, Float[Array, ""]]
    ) -> tuple[Any, Any]:
        """Add the error to its entry."""
        error = self.size(values)
        change = lambda old: old + error * (old if self.quantity.relative else 1.0)
        of_configuration = self.quantity.of_configuration
        owner = configuration if of_configuration else model
        if owner is None:
            return model, configuration
        owner = self.quantity.put(owner, entry_index(self, owner), change)
        return (model, owner) if of_configuration else (owner, configuration)
