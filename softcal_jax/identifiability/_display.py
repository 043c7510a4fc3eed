"""Numbers as a person reads them: degrees, kPa, percent."""

import math

_PREFIXED = {
    "Pa": ((1.0, "Pa"), (1e3, "kPa"), (1e6, "MPa"), (1e9, "GPa")),
    "m": ((1e-3, "mm"), (1.0, "m")),
    "rad": ((math.pi / 180.0, "deg"),),
}


def readable(value: float, unit: str) -> tuple[float, str]:
    """Factor on SI values and name of the unit in which a value reads best.

    Args:
        value: The value, in SI.
        unit: Its SI unit; one without a table here stays as it is.
    """
    steps = _PREFIXED.get(unit, ((1.0, unit),))
    size, name = steps[0]
    for step, step_name in steps[1:]:
        if abs(value) >= step:
            size, name = step, step_name
    return 1.0 / size, name


def number(value: float, digits: int = 3) -> str:
    """A number with a few digits, without an exponent where none is needed."""
    if 10.0**digits <= abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:.{digits}g}"


def quantity(value: float, unit: str, like: float | None = None) -> str:
    """A value with its unit, like "263 kPa".

    Args:
        value: The value, in SI.
        unit: Its SI unit.
        like: The value that decides the prefix; `value` by default.
    """
    factor, shown = readable(value if like is None else like, unit)
    return f"{number(value * factor)} {shown}".rstrip()


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """Lines of a table, columns aligned on the left."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    return [
        "  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in (head, *rows)
    ]
