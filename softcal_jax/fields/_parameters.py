"""The parameters to calibrate, their scaling S and where they enter the model."""

from collections.abc import Sequence
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Array, Float, is_traced


def _number(value) -> Float[Array, ""]:
    return jnp.asarray(value, float)


class Parameter(eqx.Module):
    """One unknown constant of the model.

    Attributes:
        name: Name in tables and results.
        field: The field of the law that it sets, like "E", or "density".
        start: Value before calibration, in `unit`'s SI value.
        lower: Smallest value allowed.
        upper: Largest value allowed.
        scale: "log" for moduli (a step is a ratio), "linear" otherwise.
        S: For a linear scale, the size of a unit step of lambda_p; upper - lower by
            default. A log scale needs none.
        region: Tet group that it applies to; the whole body by default.
        unit: SI unit, for tables.
    """

    name: str = eqx.field(static=True)
    field: str = eqx.field(static=True)
    start: Float[Array, ""] = eqx.field(converter=_number)
    lower: Float[Array, ""] = eqx.field(converter=_number)
    upper: Float[Array, ""] = eqx.field(converter=_number)
    scale: Literal["log", "linear"] = eqx.field(static=True, default="log")
    S: Float[Array, ""] | None = eqx.field(
        default=None, converter=lambda v: None if v is None else _number(v)
    )
    region: str | None = eqx.field(static=True, default=None)
    unit: str = eqx.field(static=True, default="")

    def __check_init__(self):
        if any(is_traced(v) for v in (self.start, self.lower)):
            return
        start, lower, upper = float(self.start), float(self.lower), float(self.upper)
        what = f"parameter {self.name!r}"
        if not np.all(np.isfinite([start, lower, upper])):
            raise ValueError(
                f"{what}: start and bounds must be finite, got start {start:g} in "
                f"[{lower:g}, {upper:g}]."
            )
        if lower >= upper:
            raise ValueError(
                f"{what}: the bounds are crossed, lower {lower:g} is not below upper "
                f"{upper:g}."
            )
        if not lower <= start <= upper:
            raise ValueError(
                f"{what}: the start {start:g} lies outside its bounds "
                f"[{lower:g}, {upper:g}]."
            )
        if self.scale not in ("log", "linear"):
            raise ValueError(
                f'{what}: scale must be "log" or "linear", got {self.scale!r}.'
            )
        if self.scale == "log" and lower <= 0.0:
            raise ValueError(
                f"{what}: a log scale needs positive bounds, got lower {lower:g}; use "
                'scale="linear".'
            )
        if self.S is not None and not float(self.S) > 0.0:
            raise ValueError(f"{what}: S must be positive, got {float(self.S):g}.")

    @property
    def unit_step(self) -> Float[Array, ""]:
        """S of a linear scale."""
        return self.upper - self.lower if self.S is None else self.S

    def to_scaled(self, p: Float[Array, ""]) -> Float[Array, ""]:
        """Scaled coordinate z: ln p, or p / S [-]."""
        return jnp.log(p) if self.scale == "log" else p / self.unit_step

    def from_scaled(self, z: Float[Array, ""]) -> Float[Array, ""]:
        """Value of a scaled coordinate: p = exp z, or p = S z."""
        return jnp.exp(z) if self.scale == "log" else z * self.unit_step


class ParameterSpace(eqx.Module):
    """The calibrated parameters, in the order of lambda_p.

    A step of the paper, p + S lambda_p, is z + lambda_p here; on a log scale
    lambda_p is the logarithm of the ratio of new and old value.
    """

    parameters: tuple[Parameter, ...] = eqx.field(converter=tuple)

    def __check_init__(self):
        if not self.parameters:
            raise ValueError("at least one parameter is needed, got none.")
        names = self.names
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"parameter {name!r} is named more than once.")

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return [parameter.name for parameter in self.parameters]

    def start(self) -> Float[Array, " n_p"]:
        """Scaled start."""
        return self.to_scaled(jnp.stack([q.start for q in self.parameters]))

    def lower(self) -> Float[Array, " n_p"]:
        """Scaled lower bounds."""
        return self.to_scaled(jnp.stack([q.lower for q in self.parameters]))

    def upper(self) -> Float[Array, " n_p"]:
        """Scaled upper bounds."""
        return self.to_scaled(jnp.stack([q.upper for q in self.parameters]))

    def to_scaled(self, p: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Scaled coordinates z of values p."""
        return jnp.stack([q.to_scaled(p[i]) for i, q in enumerate(self.parameters)])

    def from_scaled(self, z: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Values p of scaled coordinates z."""
        return jnp.stack([q.from_scaled(z[i]) for i, q in enumerate(self.parameters)])

    def apply(self, model: Any, z: Float[Array, " n_p"]) -> Any:
        """The model with the values of scaled coordinates.

        Args:
            model: Anything with `law`, `density` and `mesh`.
            z: Scaled coordinates.

        Returns:
            The model, with the fields of the law or the density replaced.

        Raises:
            ValueError: If a field or a region does not exist, or a field is not unique.
        """
        values = self.from_scaled(z)
        for value, parameter in zip(values, self.parameters, strict=True):
            model = set_field(model, parameter.field, value, parameter.region)
        return model


def set_field(
    model: Any, field: str, value: Float[ArrayLike, "..."], region: str | None = None
) -> Any:
    """The model with one constant changed; traceable and differentiable.

    Args:
        model: Anything with `law`, `density` and `mesh`.
        field: Name of a field of the law, like "E", or "density".
        value: Its new value, in SI units.
        region: Tet group that it applies to; the whole body by default.

    Returns:
        The changed model.

    Raises:
        ValueError: If the field or the region does not exist, or the field is not
            unique.
    """
    where = find_field(model, field)
    old = where(model)
    if region is None:
        new = jnp.broadcast_to(jnp.asarray(value, float), jnp.shape(old))
    else:
        tets = model.mesh.tets_of(region)
        per_tet = jnp.broadcast_to(old, (model.mesh.tets.shape[0],))
        new = per_tet.at[tets].set(value)
    return eqx.tree_at(where, model, new)


def find_field(model: Any, field: str):
    """Accessor of the field of a model's law, or of its density, that has a name.

    Args:
        model: Anything with `law` and `density`.
        field: Name of the field, like "E"; a dotted path if the name is not unique.

    Returns:
        A function from a model to that array, as `eqx.tree_at` takes it.

    Raises:
        ValueError: If no field has that name, or more than one.
    """
    paths = ["density"] + [
        "law" + jax.tree_util.keystr(path)
        for path, _ in jax.tree_util.tree_leaves_with_path(model.law)
    ]
    found = [path for path in paths if ("." + path).endswith("." + field)]
    if len(found) != 1:
        problem = "is not unique" if found else "does not exist"
        raise ValueError(
            f"field {field!r} of the model {problem}; it has {', '.join(paths)}."
        )

    def where(model):
        leaf = model
        for name in found[0].split("."):
            leaf = getattr(leaf, name)
        return leaf

    return where


def as_space(
    parameters: "ParameterSpace | Parameter | Sequence[Parameter]",
) -> ParameterSpace:
    """A parameter space of one parameter or several."""
    if isinstance(parameters, ParameterSpace):
        return parameters
    if isinstance(parameters, Parameter):
        return ParameterSpace((parameters,))
    return ParameterSpace(tuple(parameters))
