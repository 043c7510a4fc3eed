"""Entries of errors that are considered and never calibrated.

Only their derivative at zero counts, where they change nothing.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.fields._model_fields import find_field, set_field
from softcal_jax.fields._parameters import (
    AbstractEntry,
    Names,
    Parameter,
    Values,
    as_number,
)
from softcal_jax.fields._setup import AbstractSetupEntry


class AbstractError(AbstractEntry):
    """One unknown about zero, in units of its standard deviation.

    Attributes:
        name: Its name.
        std: Its standard deviation, in SI units or relative.
    """

    name: str = eqx.field(static=True)
    std: Float[Array, ""] = eqx.field(converter=as_number)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its unknown."""
        unknown = Parameter(
            self.name, "", 0.0, -1.0, 1.0, scale="linear", S=1.0, prior_std=1.0
        )
        return (unknown,)

    def renamed(self, points: Names, names: Names) -> "AbstractError":
        """Return the same error with another name."""
        del points
        return replace(self, name=names[self.name])


class FieldError(AbstractError):
    """An error of a field of the law, or of the density.

    Attributes:
        field: The field, as `find_field` finds it.
        share: Error of each tet per unit of the unknown; 0 where it is calibrated.
        relative: Whether the error is relative to the value.
    """

    field: str = eqx.field(static=True)
    share: Float[Array, " n_tets"]
    relative: bool = eqx.field(static=True, default=False)

    @property
    def fields(self) -> tuple[str, ...]:
        return (self.field,)

    def check(self, model: Any) -> None:
        find_field(model, self.field)

    def apply(self, model: Any, configuration: Any, values: Values) -> tuple[Any, Any]:
        """Add the error to the field."""
        old = jnp.broadcast_to(find_field(model, self.field)(model), self.share.shape)
        error = values[self.name] * self.std * self.share
        new = old + error * (old if self.relative else 1.0)
        return set_field(model, self.field, new), configuration


class SetupError(AbstractError, AbstractSetupEntry):
    """An error of the setup, the loads or a recording, added to its present value.

    The error of a factor is relative; for `kind`, `of` and `axis` see `SetupParameter`.
    """

    kind: str = eqx.field(static=True)
    of: str = eqx.field(static=True, default="")
    axis: str = eqx.field(static=True, default="")

    def apply(self, model: Any, configuration: Any, values: Values) -> tuple[Any, Any]:
        """Add the error to its entry."""
        error = values[self.name] * self.std
        change = lambda old: old + error * (old if self.quantity.relative else 1.0)
        return self._changed(model, configuration, change)
