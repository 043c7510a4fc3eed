"""Values and standard errors as readable text."""

import math
from collections.abc import Sequence

from softcal_jax._units import readable_unit


def readable_estimate(value: float, standard_error: float, unit: str) -> str:
    """Format a value with its standard error, like "263.8 ± 5.9 kPa".

    The error has two significant digits and the value as many decimals. Without a
    standard error the value has four digits.

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
        error = float(f"{error:.1e}")  # round first: 0.996 becomes 1.0
        decimals = 1 - math.floor(math.log10(error))
        if decimals > 9:  # too many to read
            text = f"{value:.4g} ± {error:.1e}"
        else:
            places = max(decimals, 0)
            text = f"{round(value, decimals):.{places}f} ± "
            text += f"{round(error, decimals):.{places}f}"
    return f"{text} {shown}".rstrip()


def readable_values(values: Sequence[float], unit: str, *, digits: int = 4) -> str:
    """Format one value or several in a readable unit.

    Args:
        values: Values, in SI.
        unit: Their SI unit.
        digits: Significant digits.
    """
    factor, shown = readable_unit(values, unit)
    largest = max(abs(factor * value) for value in values)
    if largest == 0.0:
        factor, shown = 1.0, unit  # all zero: no prefix reads better
    # Values far below the largest are rounding errors, like 1e-13 N beside 2 N.
    kept = [v if abs(factor * v) > 1e-6 * largest else 0.0 for v in values]
    texts = [f"{factor * value:.{digits}g}" for value in kept]
    listed = texts[0] if len(texts) == 1 else f"({', '.join(texts)})"
    return f"{listed} {shown}"
