"""Units that a person reads: kPa instead of 2.638e+05 Pa, degrees instead of rad."""

import math
from collections.abc import Iterable
from typing import NamedTuple


class Readable(NamedTuple):
    """A unit for display: shown value = SI value * factor."""

    factor: float
    unit: str


# Ascending; the largest one that keeps the value at or above 1 is taken.
_PREFIXED = {
    "Pa": ((1.0, "Pa"), (1e3, "kPa"), (1e6, "MPa"), (1e9, "GPa")),
    "m": ((1e-3, "mm"), (1.0, "m")),
    "rad": ((math.pi / 180.0, "deg"),),
}


def readable_unit(values: Iterable[float], unit: str) -> Readable:
    """The unit in which values of one SI unit read best.

    Args:
        values: Values in SI; the largest decides.
        unit: Their SI unit; one without a table here stays as it is.

    Returns:
        The factor on SI values, and the unit's name.
    """
    steps = _PREFIXED.get(unit, ((1.0, unit),))
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    size, name = steps[0]
    for step, step_name in steps[1:]:
        if largest >= step:
            size, name = step, step_name
    return Readable(1.0 / size, name)


def readable_estimate(value: float, standard_error: float, unit: str) -> str:
    """A value with its standard error, like "263.8 ± 5.9 kPa".

    The error has two significant digits and the value as many decimals. A standard
    error that does not exist is left out, and the value has four digits.

    Args:
        value: The value, in SI.
        standard_error: Its standard error, in SI; nan if there is none.
        unit: SI unit.

    Returns:
        The text.
    """
    factor, shown = readable_unit([value], unit)
    value, error = value * factor, standard_error * factor
    if not math.isfinite(error):
        text = f"{value:.4g}"
    elif error == 0.0:
        text = f"{value:.4g} ± 0"
    else:
        error = float(f"{error:.1e}")  # first, since 0.996 becomes 1.0
        decimals = 1 - math.floor(math.log10(error))
        if decimals > 9:  # too many digits to read
            text = f"{value:.4g} ± {error:.1e}"
        else:
            places = max(decimals, 0)
            text = f"{round(value, decimals):.{places}f} ± "
            text += f"{round(error, decimals):.{places}f}"
    return f"{text} {shown}".rstrip()
