"""Readable units: kPa instead of 2.638e+05 Pa, degrees instead of rad."""

import math
from collections.abc import Iterable
from typing import NamedTuple


class Readable(NamedTuple):
    """A unit for display: shown value = SI value * factor."""

    factor: float
    unit: str


# Ascending; the largest that keeps the value at or above 1 is used.
_PREFIXED = {
    "Pa": ((1.0, "Pa"), (1e3, "kPa"), (1e6, "MPa"), (1e9, "GPa")),
    "m": ((1e-3, "mm"), (1.0, "m")),
    "m3": ((1e-9, "mm3"), (1e-6, "ml"), (1.0, "m3")),
    "N": ((1e-3, "mN"), (1.0, "N"), (1e3, "kN")),
    "N m": ((1e-3, "N mm"), (1.0, "N m")),
    "rad": ((math.pi / 180.0, "deg"),),
}


def readable_unit(values: Iterable[float], unit: str) -> Readable:
    """Choose the unit in which values of one SI unit read best.

    Args:
        values: Values in SI; the largest decides.
        unit: Their SI unit; unlisted ones stay as they are.

    Returns:
        The factor on SI values, and the name of the unit.
    """
    steps = _PREFIXED.get(unit, ((1.0, unit),))
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    size, name = steps[0]
    for step, step_name in steps[1:]:
        if largest >= step:
            size, name = step, step_name
    return Readable(1.0 / size, name)


def readable(value: float, unit: str) -> str:
    """Format an SI value in a readable unit, like "263.8 kPa"."""
    factor, shown = readable_unit([value], unit)
    return f"{factor * value:.6g} {shown}".rstrip()
