"""One unknown constant: bounds, scaling S and place in the model."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, is_traced
from softcal_jax._units import readable
from softcal_jax.fields._entry import AbstractEntry
from softcal_jax.fields._model_fields import find_field, set_field
from softcal_jax.materials import is_point_values


def _number(value) -> Float[Array, ""]:
    return jnp.asarray(value, float)


class Parameter(AbstractEntry):
    """One unknown constant of the model.

    Attributes:
        name: Name in tables and results.
        field: The field of the law that it sets, like "E", or "density".
        start: Value before calibration, in SI units.
        lower: Smallest value allowed.
        upper: Largest value allowed.
        scale: "log" for moduli (a step is a ratio), "linear" otherwise.
        S: For a linear scale, the size of a unit step of lambda_p; upper - lower by
            default. A log scale needs none.
        region: Tet group that it applies to; the whole body by default.
        unit: SI unit, for tables.
        max_step: Largest entry of lambda_p in one step, like the step limits of the
            paper; on a log scale 0.01 is 1 %. None leaves it to the trust region [-].
        periodic: Whether both bounds are equivalent, as for the angle of an axis, -90
            to 90 degrees: a step past one bound re-enters at the other.
        prior_std: Standard deviation of the prior about `start`: relative on a log
            scale (0.3 is 30 %), in SI units on a linear one. None without a prior.
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
    max_step: Float[Array, ""] | None = eqx.field(
        default=None, converter=lambda v: None if v is None else _number(v)
    )
    periodic: bool = eqx.field(static=True, default=False)
    prior_std: Float[Array, ""] | None = eqx.field(
        default=None, converter=lambda v: None if v is None else _number(v)
    )

    def __check_init__(self):
        if any(is_traced(v) for v in (self.start, self.lower)):
            return
        start, lower, upper = float(self.start), float(self.lower), float(self.upper)
        what = f"parameter {self.name!r}"
        show = lambda value: readable(value, self.unit)
        if not np.all(np.isfinite([start, lower, upper])):
            raise ValueError(
                f"{what}: start and bounds must be finite, got start {start:g} in "
                f"[{lower:g}, {upper:g}]."
            )
        if lower >= upper:
            raise ValueError(
                f"{what}: the bounds are crossed, lower {show(lower)} is not below "
                f"upper {show(upper)}."
            )
        if not lower <= start <= upper:
            raise ValueError(
                f"{what}: the start {show(start)} lies outside its bounds "
                f"[{show(lower)}, {show(upper)}]."
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
        if self.max_step is not None and not float(self.max_step) > 0.0:
            raise ValueError(
                f"{what}: max_step must be positive, got {float(self.max_step):g}."
            )

        if self.prior_std is not None and not float(self.prior_std) > 0.0:
            raise ValueError(
                f"{what}: prior_std must be positive, got {float(self.prior_std):g}; "
                "leave it out where nothing is known before."
            )

    @property
    def parameters(self) -> tuple["Parameter", ...]:
        """The unknowns that it adds: itself."""
        return (self,)

    @property
    def unit_step(self) -> Float[Array, ""]:
        """S of a linear scale."""
        return self.upper - self.lower if self.S is None else self.S

    def prior_weight(self) -> Float[Array, ""]:
        """Return 1 / standard deviation of the scaled prior; 0 without one [-]."""
        if self.prior_std is None:
            return jnp.zeros(())
        unit = jnp.ones(()) if self.scale == "log" else self.unit_step
        return unit / self.prior_std

    def to_scaled(self, p: Float[Array, ""]) -> Float[Array, ""]:
        """Compute the scaled coordinate z: ln p, or p / S [-]."""
        return jnp.log(p) if self.scale == "log" else p / self.unit_step

    def from_scaled(self, z: Float[Array, ""]) -> Float[Array, ""]:
        """Compute the value of a scaled coordinate: p = exp z, or p = S z."""
        return jnp.exp(z) if self.scale == "log" else z * self.unit_step

    @property
    def fields(self) -> tuple[str, ...]:
        """The field that it sets."""
        return (self.field,)

    @property
    def tet_group(self) -> str | None:
        """The region that it sets the field in."""
        return self.region

    @property
    def label(self) -> str:
        """Its name."""
        return self.name

    def apply(
        self, model: Any, configuration: Any, values: Mapping[str, Float[Array, ""]]
    ) -> tuple[Any, Any]:
        """Set its field to one value in its region."""
        value = values[self.name]
        return set_field(model, self.field, value, self.region), configuration

    def check(self, model: Any) -> None:
        """Raise ValueError if it would overwrite values that differ over the mesh."""
        value = find_field(model, self.field)(model)
        values = np.asarray(value.values if is_point_values(value) else value)
        if self.region is None and values.ndim and np.ptp(values) > 0:
            raise ValueError(
                f"parameter {self.name!r} would give the whole body one value of "
                f"{self.field}, which now lies between {values.min():g} and "
                f"{values.max():g}. Name the tet group it is for in `region`."
            )

    def renamed(
        self, points: Mapping[str, str], names: Mapping[str, str]
    ) -> "Parameter":
        """Return the same parameter with another name."""
        del points
        return replace(self, name=names[self.name])
