"""Readable units: kPa instead of 2.638e+05 Pa, degrees instead of rad."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

# Ascending; the largest that keeps the value at or above 1 is used.
_PREFIXED = {
    "Pa": ((1.0, "Pa"), (1e3, "kPa"), (1e6, "MPa"), (1e9, "GPa")),
    "m": ((1e-3, "mm"), (1.0, "m")),
    "m2": ((1e-6, "mm2"), (1.0, "m2")),
    "m3": ((1e-9, "mm3"), (1e-6, "ml"), (1.0, "m3")),
    "N": ((1e-3, "mN"), (1.0, "N"), (1e3, "kN")),
    "N m": ((1e-3, "N mm"), (1.0, "N m")),
    "rad": ((math.pi / 180.0, "deg"),),
}


def readable_unit(values: Iterable[float], unit: str) -> tuple[float, str]:
    """Choose the unit in which values of one SI unit read best, and its factor.

    The largest value decides; a unit that is not listed stays as it is.
    """
    steps = _PREFIXED.get(unit, ((1.0, unit),))
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    size, name = max((step for step in steps if largest >= step[0]), default=steps[0])
    return 1.0 / size, name


def readable(value: float, unit: str) -> str:
    """Format an SI value in a readable unit, like "263.8 kPa"; nan is "unknown"."""
    if math.isnan(value):
        return "unknown"
    factor, shown = readable_unit([value], unit)
    return f"{factor * value:.6g} {shown}".rstrip()


def readable_estimate(value: float, standard_error: float, unit: str) -> str:
    """Format an SI value with its standard error, like "263.8 ± 5.9 kPa".

    The error has two significant digits and the value as many decimals. Where the
    standard error is nan, the value has four digits.
    """
    factor, shown = readable_unit([value], unit)
    value, error = value * factor, standard_error * factor
    if not math.isfinite(error):
        text = f"{value:.4g}"
    elif error == 0.0:
        text = f"{value:.4g} ± 0"
    else:
        error = float(f"{error:.1e}")  # round first: 0.996 becomes 1.0
        decimals = 1 - math.floor(math.log10(error))
        if decimals > 9:  # too many to read
            text = f"{value:.4g} ± {error:.1e}"
        else:
            shape = f".{max(decimals, 0)}f"
            both = (round(number, decimals) for number in (value, error))
            text = " ± ".join(f"{number:{shape}}" for number in both)
    return f"{text} {shown}".rstrip()


def readable_values(values: Sequence[float], unit: str, *, digits: int = 4) -> str:
    """Format one SI value or several in a readable unit, with so many digits.

    A nan among several is "-", as in a goal; if none is known, it is "unknown".
    """
    if len(values) and all(map(math.isnan, values)):
        return "unknown"
    factor, shown = readable_unit(values, unit)
    finite = [abs(factor * value) for value in values if math.isfinite(value)]
    largest = max(finite, default=0.0)
    if largest == 0.0:
        factor, shown = 1.0, unit  # all zero: no prefix reads better
    # Values far below the largest are rounding errors, like 1e-13 N beside 2 N.
    kept = [0.0 if abs(factor * v) <= 1e-6 * largest else v for v in values]
    texts = [f"{factor * v:.{digits}g}" if not math.isnan(v) else "-" for v in kept]
    listed = texts[0] if len(texts) == 1 else f"({', '.join(texts)})"
    return f"{listed} {shown}"


def is_number(value: Any) -> bool:
    """Whether a value of a file is a number without a unit; true and false are not."""
    return isinstance(value, int | float) and not isinstance(value, bool)
