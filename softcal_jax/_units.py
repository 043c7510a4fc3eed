"""Units that are read and written: kPa instead of 2.638e+05 Pa, degrees for rad."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "inch": 0.0254}
"""Length units of meshes and marker files."""

UNITS: dict[str, dict[str, float]] = {
    "m": METRES,
    "m2": {"m2": 1.0, "mm2": 1e-6},
    "m3": {"m3": 1.0, "cm3": 1e-6, "mm3": 1e-9, "l": 1e-3, "ml": 1e-6},
    "Pa": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "mbar": 1e2, "bar": 1e5}
    | {"N/m2": 1.0, "N/mm2": 1e6},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "N m": {"N m": 1.0, "N mm": 1e-3, "mN m": 1e-3},
    "N/m3": {"N/m3": 1.0, "Pa/m": 1.0, "N/mm3": 1e9, "GPa/m": 1e9},
    "kg": {"kg": 1.0, "g": 1e-3, "mg": 1e-6},
    "kg/m3": {"kg/m3": 1.0, "g/cm3": 1e3, "kg/dm3": 1e3},
    "m/s2": {"m/s2": 1.0, "mm/s2": 1e-3},
    "s": {"s": 1.0, "ms": 1e-3},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0},
}
"""Units of nearly every file, by SI unit: pint takes a second to read all it knows."""

# Ascending; the largest that keeps the value at or above 1 is used.
_WRITTEN = {
    "Pa": ("Pa", "kPa", "MPa", "GPa"),
    "m": ("mm", "m"),
    "m2": ("mm2", "m2"),
    "m3": ("mm3", "ml", "m3"),
    "N": ("mN", "N", "kN"),
    "kg": ("g", "kg"),
    "N m": ("N mm", "N m"),
    "rad": ("deg",),
}


QUANTITIES: dict[str, tuple[str, float, int | str]] = {
    "distance": ("mm", 1e3, ".2f"),
    "step of a fit": ("mm", 1e3, ".3f"),
    "about": ("mm", 1e3, 2),
    "turn": ("deg", 180.0 / math.pi, ".2f"),
    "time": ("s", 1.0, ".1f"),
    "share": ("%", 100.0, ".1f"),
    "percent": ("%", 100.0, 3),
    "correlation": ("", 1.0, ".2f"),
    "ratio": ("", 1.0, 3),
    "step": ("", 1.0, 2),
    "count": ("", 1.0, ".0f"),
}
"""How results write what is no size in an SI unit, which has four significant digits.

The unit, its factor from SI, and significant digits or a format.
"""


def number(value: float, digits: int | str = 4) -> str:
    """Write a number with so many digits, without an exponent where none is needed."""
    if isinstance(digits, str):
        return f"{value:{digits}}"
    if 10.0**digits <= abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:.{digits}g}"


def readable_unit(values: Iterable[float], unit: str) -> tuple[float, str]:
    """Choose the unit in which values of one SI unit read best, and its factor.

    The largest value decides; a unit that is not listed stays as it is.
    """
    if unit in QUANTITIES:
        name, factor, _ = QUANTITIES[unit]
        return factor, name
    steps = [(UNITS[unit][name], name) for name in _WRITTEN.get(unit, ())]
    steps = steps or [(1.0, unit)]
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    size, name = max((step for step in steps if largest >= step[0]), default=steps[0])
    return 1.0 / size, name


def readable(value: float, unit: str) -> str:
    """Format an SI value in a readable unit, like "263.8 kPa"; nan is "unknown"."""
    if math.isnan(value):
        return "unknown"
    factor, shown = readable_unit([value], unit)
    form = QUANTITIES[unit][2] if unit in QUANTITIES else 6
    return f"{number(factor * value, form)} {shown}".rstrip()


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


def readable_values(
    values: Sequence[float], unit: str, *, digits: int = 4, beside: Iterable[float] = ()
) -> str:
    """Format one SI value or several in a readable unit, with so many digits.

    The unit is that of all that stands `beside` them, too; `unit` may be one of the
    `QUANTITIES`. A nan among several is "-", as in a goal; if none is known, it is
    "unknown".
    """
    if len(values) and all(map(math.isnan, values)):
        return "unknown"
    every = [*values, *beside]
    factor, shown = readable_unit(every, unit)
    form = QUANTITIES[unit][2] if unit in QUANTITIES else digits
    if len(_WRITTEN.get(unit, ())) > 1 and not any(v == v and v for v in every):
        factor, shown = 1.0, unit  # all zero: no prefix reads better
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    # Values far below the largest are rounding errors, like 1e-13 N beside 2 N.
    kept = [0.0 if abs(v) <= 1e-6 * largest else v for v in values]
    texts = ["-" if math.isnan(v) else number(factor * v, form) for v in kept]
    listed = texts[0] if len(texts) == 1 else f"({', '.join(texts)})"
    return f"{listed} {shown}"


def is_number(value: Any) -> bool:
    """Whether a value of a file is a number without a unit; true and false are not."""
    return isinstance(value, int | float) and not isinstance(value, bool)
