"""Numbers and tables in readable form."""

from softcal_jax._units import readable_unit


def number(value: float, digits: int = 3) -> str:
    """Format a number with a few digits, without an exponent where none is needed."""
    if 10.0**digits <= abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:.{digits}g}"


def quantity(value: float, unit: str, like: float | None = None) -> str:
    """Format a value with its unit, as in "263 kPa".

    Args:
        value: The value, in SI.
        unit: Its SI unit.
        like: The value that selects the prefix; `value` by default.
    """
    factor, shown = readable_unit([value if like is None else like], unit)
    return f"{number(value * factor)} {shown}".rstrip()


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """Format the lines of a table, columns aligned on the left."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    return [
        "  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in (head, *rows)
    ]
