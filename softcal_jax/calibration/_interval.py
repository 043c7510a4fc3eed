"""The confidence interval of a calibrated parameter, and how it was found."""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float
from softcal_jax._units import readable_unit
from softcal_jax.fields import Parameter

IntervalEnd = Literal["likelihood", "bound", "not found"]
IntervalKind = Literal["first-order", "profile", "one-sided", "none"]


class ProfileEnd(NamedTuple):
    """One end of an interval: its scaled distance from the fit, nan if not found [-].

    `why` says what ends it, as in `ParameterInterval`.
    """

    distance: float
    why: IntervalEnd


class ParameterInterval(Module):
    """Confidence interval of a calibrated parameter, in SI units.

    Attributes:
        name: Its name.
        level: Confidence [-].
        lower: Lower end; nan if it was not found.
        upper: Upper end; likewise. A periodic angle may lie beyond its bounds.
        lower_end: What ends it below: "likelihood"; "bound", if the data do not exclude
            the bound of the parameter (or half a turn of a periodic angle); or "not
            found", if fits along the profile did not converge, or were not tried.
        upper_end: The same above.
        unit: SI unit.
        kind: How it was found: "first-order", from a standard error that the cost
            confirms; "profile", from the likelihood itself; "one-sided", likewise, with
            a limit on one side and a bound on the other; or "none".
        why: Why there is none; empty if there is one.
    """

    name: str
    level: float
    lower: float
    upper: float
    lower_end: IntervalEnd
    upper_end: IntervalEnd
    unit: str
    kind: IntervalKind = "profile"
    why: str = ""

    @property
    def is_any_angle(self) -> bool:
        """Whether it is a whole turn of an axis."""
        turn = self.unit == "rad" and np.isclose(self.upper - self.lower, np.pi)
        return bool(turn) and self.lower_end == self.upper_end == "bound"

    def __str__(self) -> str:
        """Write its ends in a readable unit, or why there are none, in one line."""
        if self.is_any_angle:
            return "any angle"
        if self.kind == "none":
            return self.why
        factor, unit = readable_unit([self.lower, self.upper], self.unit)
        both = (self.lower, self.lower_end), (self.upper, self.upper_end)
        words = {"bound": " (bound)"}
        ends = [f"{factor * value:.4g}{words.get(end, '')}" for value, end in both]
        return f"{ends[0]} to {ends[1]} {unit}".rstrip()


def interval_between(
    own: Parameter,
    z: Float[Array, ""],
    ends: Sequence[ProfileEnd],
    *,
    level: float,
    first_order: bool = False,
) -> ParameterInterval:
    """Make the interval of a parameter from the distances of its ends.

    Args:
        own: The parameter.
        z: Its scaled value [-].
        ends: Its lower and its upper end.
        level: Confidence [-].
        first_order: Whether the ends are those of a standard error.
    """
    low, high = ends
    kind, why = _kind(low, high, own, z, first_order)
    return ParameterInterval(
        name=own.name,
        level=level,
        lower=float(own.from_scaled(z - low.distance)),
        upper=float(own.from_scaled(z + high.distance)),
        lower_end=low.why,
        upper_end=high.why,
        unit=own.unit,
        kind=kind,
        why=why,
    )


def no_interval(own: Parameter, *, level: float, why: str) -> ParameterInterval:
    """Make the interval of a parameter that has none."""
    ends = (math.nan, math.nan, "not found", "not found")
    return ParameterInterval(own.name, level, *ends, own.unit, "none", why)


def _kind(low, high, own: Parameter, z, first_order: bool) -> tuple[IntervalKind, str]:
    """Name the kind of an interval, and why it is none."""
    found = [end.why for end in (low, high)]
    if "not found" in found:
        why = "fits along its profile do not converge"
        for end, sign, side in ((low, -1.0, "below"), (high, 1.0, "above")):
            if end.why == "likelihood":
                value = float(own.from_scaled(z + sign * end.distance))
                factor, unit = readable_unit([value], own.unit)
                text = f"{factor * value:.4g} {unit}".rstrip()
                why += f" (the end {side} is {text})"
        return "none", why
    if found == ["bound", "bound"]:
        return "none", "the data exclude no value within its bounds"
    if "bound" in found:
        return "one-sided", ""
    return ("first-order" if first_order else "profile"), ""
