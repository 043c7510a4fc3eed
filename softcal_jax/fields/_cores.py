"""Axes whose contrast fades where the directions of their control points cancel."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.fields._entry import AbstractEntry
from softcal_jax.fields._spread import ControlPointParameters

Entries = tuple[AbstractEntry, ...]


class FadingAxis(NamedTuple):
    """The three fields of an axis whose angle has a core."""

    small: ControlPointParameters
    large: ControlPointParameters
    angle: ControlPointParameters

    def apply(self, model: Any, values: Mapping[str, Float[Array, ""]]) -> Any:
        """Reduce the contrast of the moduli in the cores.

        Their geometric mean and the angle stay.

        Args:
            model: The model, with the three fields as without a core.
            values: Values of all parameters by name, in SI units.
        """
        low, high = (
            jnp.log(entry.evaluate(model.mesh, values))
            for entry in (self.small, self.large)
        )
        middle, half = 0.5 * (high + low), 0.5 * (high - low)
        half = half * self.angle.contrast(model.mesh, values)
        model = self.small.set_on(model, jnp.exp(middle - half))
        return self.large.set_on(model, jnp.exp(middle + half))


def fading_axes(
    entries: Entries, axes: tuple[tuple[str, str, str], ...]
) -> list[FadingAxis]:
    """Return the axes whose angle has a core.

    Args:
        entries: Entries of a parameter space.
        axes: Triples (smaller modulus, larger modulus, angle) of fields.

    Raises:
        ValueError: If an angle with a core belongs to no axis, or if the moduli of its
            axis are not sampled where it is.
    """
    fields = [e for e in entries if isinstance(e, ControlPointParameters)]
    found = []
    for angle in fields:
        if angle.core == 0.0:
            continue
        its = [axis for axis in axes if axis[2] == angle.field]
        if not its:
            raise ValueError(
                f"{angle.field} has a core, in which the contrast of two moduli fades: "
                f'say which in axes, like ("E_l", "E_t", "{angle.field}"), or leave '
                "core out."
            )
        small, large = (_beside(angle, name, fields) for name in its[0][:2])
        found.append(FadingAxis(small, large, angle))
    return found


def _beside(
    angle: ControlPointParameters, field: str, fields: list[ControlPointParameters]
) -> ControlPointParameters:
    """Return the entry of a field with the region and sampling of the angle."""
    where = (angle.region, angle.sampling)
    for entry in fields:
        if entry.field == field and (entry.region, entry.sampling) == where:
            return entry
    raise ValueError(
        f"{angle.field} has a core, and {field} is not sampled where it is: give both "
        f"region={angle.region!r} and sampling={angle.sampling!r}, or leave core out."
    )
