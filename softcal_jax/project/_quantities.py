"""Kinds of typed values, like "200 kPa" and "(0, 0, -1) N", and how each is parsed."""

import contextlib
import math
import re
from collections.abc import Sequence
from functools import partial
from typing import Annotated, Any, NamedTuple

from pydantic import BeforeValidator

from softcal_jax._module import Size
from softcal_jax._text import shortened, suggestion
from softcal_jax._units import UNITS, is_number


class Dimension(NamedTuple):
    """Physical dimension of a quantity: its name, its SI unit and an example."""

    name: str
    si: str
    example: str


_DIMENSIONS = (
    Dimension("a length", "m", "100 mm"),
    Dimension("a volume", "m3", "2 ml"),
    Dimension("an angle", "rad", "20 deg"),
    Dimension("a force", "N", "0.51 N"),
    Dimension("a pressure or modulus", "Pa", "200 kPa"),
    Dimension("a torque", "N m", "50 N*mm"),
    Dimension("a density", "kg/m3", "1070 kg/m^3"),
    Dimension("a stiffness per area", "N/m3", "1 GPa/m"),
    Dimension("an acceleration", "m/s2", "9.81 m/s^2"),
    Dimension("a time", "s", "1.3 s"),
    Dimension("a mass", "kg", "10 g"),
)
_OF_UNIT = {dimension.si: dimension for dimension in _DIMENSIONS}
"""Dimension of each SI unit, as laws, actuators and effectors name it."""


def dimension_of(unit: str) -> Dimension:
    """Return the dimension of an SI unit; an unlisted unit makes its own."""
    spelt = _spelt(unit)
    return _OF_UNIT.get(spelt, Dimension(f"a quantity in {unit}", spelt, f"1 {unit}"))


_SI_OF = {unit: si for si, units in UNITS.items() for unit in units}

# pint treats angles as plain numbers, so it would accept "20 %" as an angle.
_ANGLES = ("degree", "radian", "milliradian", "turn")

_NUMBER = r"[+-]?(?:inf|(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
_NAME = r"[A-Za-zµμ°%]+(?:(?:\^|\*\*)?-?\d+|[²³])?"
# Only products and quotients of named units reach pint's own parser.
_UNIT = re.compile(rf"{_NAME}(?:(?:\s*[*/·]\s*|\s+){_NAME})*")
_SHARE = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*%\s*")
_SCALAR = re.compile(rf"\s*({_NUMBER})\s*(.*?)\s*")
_VECTOR = re.compile(r"\s*[(\[](.*)[)\]]\s*(.*?)\s*")


def _spelt(unit: str) -> str:
    """Spell a unit as `UNITS` does: people write "m^3" for "m3", "N*m" for "N m"."""
    plain = re.sub(r"\^|\*\*", "", unit.replace("²", "2").replace("³", "3"))
    return re.sub(r"\s*([*/·])\s*|\s+", lambda m: "/" if m[1] == "/" else " ", plain)


def _by_pint(unit: str) -> str:
    """Mark the powers of a unit that is spelt as in `UNITS`, as pint asks."""
    return re.sub(r"(?<=[A-Za-zµμ])(-?\d)", r"^\1", unit)


def _factor(unit: str, dimension: Dimension, value: str) -> float:
    """Return one `unit` in SI; messages quote `value`, the text that it stands in."""
    expected = f'expected {dimension.name}, like "{dimension.example}"'
    if not _UNIT.fullmatch(unit):
        raise ValueError(f'"{value}": cannot read the unit "{unit}"; {expected}.')
    misfit = f'"{value}": "{unit}" is not {dimension.name}; {expected}.'
    common, spelt = UNITS.get(dimension.si, {}), _spelt(unit)
    if spelt in common:
        return common[spelt]
    if spelt in _SI_OF and common:
        raise ValueError(misfit)
    import pint

    registry = pint.get_application_registry()
    try:
        one = registry.Quantity(1.0, registry.parse_units(_by_pint(spelt)))
    except pint.UndefinedUnitError as error:
        unknown = f'"{value}": unknown unit "{unit}"; {expected}.'
        hint = suggestion(unit, common, quote='"')
        raise ValueError(f"{unknown}{hint}") from error
    si = _by_pint(dimension.si)
    angle = dimension.si != "rad" or str(one.units) in _ANGLES
    if not (angle and one.is_compatible_with(si)):
        # "kP" is no slip to pint, which knows the kilopoise.
        raise ValueError(misfit + suggestion(unit, common, quote='"'))
    return float(one.to(si).magnitude)


def shown(value: Any) -> str:
    """Format a value as a project file writes it."""
    return f'"{shortened(value)}"' if isinstance(value, str) else shortened(str(value))


def recognised(text: str) -> tuple[tuple[float, ...], str] | None:
    """Read a quantity of any dimension: one value or three, and their SI unit."""
    for unit in _OF_UNIT:
        with contextlib.suppress(ValueError):
            if _VECTOR.fullmatch(text):
                return parse_vector(text, unit), unit
            return (parse_in_si(text, unit),), unit
    return None


_WITHIN = {
    "any": (lambda x: True, ""),
    "finite": (math.isfinite, ""),
    "not negative": (lambda x: 0.0 <= x < math.inf, ", zero or more"),
    "positive": (lambda x: 0.0 < x < math.inf, " above zero"),
}


def _check_size(numbers: Sequence[float], size: Size, value: Any) -> None:
    """Raise ValueError unless numbers are of a size; `value` is what was typed."""
    within, words = _WITHIN[size]
    if not all(map(within, numbers)):
        raise ValueError(f"got {shown(value)}; expected a finite value{words}.")


def parse_in_si(value: Any, unit: str, size: Size = "any") -> float:
    """Parse "200 kPa" into the SI unit: "%" for a share, "" for a plain number.

    Raises:
        ValueError: If it is not such a value; the text shows an example.
    """
    text = value if isinstance(value, str) else ""
    if unit == "%":
        match = _SHARE.fullmatch(text)
        if match is None:
            raise ValueError(f'got {shown(value)}; expected a share, like "3 %".')
        number = 0.01 * float(match[1])
    elif not unit:
        if not is_number(value):
            raise ValueError(f"got {shown(value)}; expected a number, like 0.45.")
        number = float(value)
    else:
        match, dimension = _SCALAR.fullmatch(text), dimension_of(unit)
        if match is None or not match[2]:
            bare = float(match[1]) if match else value
            got = f"got {shown(value)}"
            if is_number(bare):
                got = f"{bare:.15g} has no unit"
            raise ValueError(
                f"{got}; expected {dimension.name}, in quotes and with its unit, like "
                f'"{dimension.example}".'
            )
        number = float(match[1]) * _factor(match[2], dimension, text)
    _check_size([number], size, value)
    return number


def parse_vector(
    value: Any, unit: str, size: Size = "any"
) -> tuple[float, float, float]:
    """Parse "(0, 15, 36) mm" or ["0 mm", "15 mm", "36 mm"] into the SI unit."""
    dimension = dimension_of(unit)
    example = dimension.example.split()[-1]
    expected = f'expected three numbers with a unit, like "(0, 0, -1) {example}"'
    if isinstance(value, list):
        parts = [parse_in_si(part, unit) for part in value]
    else:
        match = _VECTOR.fullmatch(value) if isinstance(value, str) else None
        if match is None:
            raise ValueError(f"got {shown(value)}; {expected}.")
        if not match[2]:
            raise ValueError(f'"{value}" has no unit; {expected}.')
        numbers = [part.strip() for part in match[1].split(",")]
        for number in numbers:
            if not re.fullmatch(_NUMBER, number):
                raise ValueError(f'"{value}": "{number}" is not a number; {expected}.')
        factor = _factor(match[2], dimension, value)
        parts = [float(number) * factor for number in numbers]
    if len(parts) != 3:
        raise ValueError(f"got {len(parts)} numbers; {expected}.")
    _check_size(parts, size, value)
    x, y, z = parts
    return x, y, z


def scalar(unit: str, size: Size = "any") -> BeforeValidator:
    """Mark a type that is read as a quantity in a unit, of a size."""
    return BeforeValidator(partial(parse_in_si, unit=unit, size=size))


def vector(unit: str, size: Size = "finite") -> BeforeValidator:
    """Mark a type that is read as a vector in a unit, each component of a size."""
    return BeforeValidator(partial(parse_vector, unit=unit, size=size))


def deviation(unit: str, *words: str) -> BeforeValidator:
    """Mark a type that is read as a size or as one of `words`; zero needs no unit."""

    def parsed(value: Any) -> float | str:
        if value in words:
            return value
        zero = is_number(value) and value == 0
        return 0.0 if zero else parse_in_si(value, unit, "not negative")

    return BeforeValidator(parsed)


def parse_direction(value: Any) -> tuple[float, float, float]:
    """Parse a unit vector from "-z" or [0, 0, -1]."""
    axis = isinstance(value, str) and re.fullmatch(r"([+-]?)([xyz])", value.strip())
    if axis:
        sign = -1.0 if axis[1] == "-" else 1.0
        x, y, z = (sign * (letter == axis[2]) for letter in "xyz")
        return x, y, z
    numbers = value if isinstance(value, list) else []
    if len(numbers) != 3 or not all(map(is_number, numbers)):
        raise ValueError(f'got {shown(value)}; expected "-z" or [0, 0, -1].')
    length = math.hypot(*numbers)
    if not 0.0 < length < math.inf:
        raise ValueError(f"got {value}; a direction has a finite length above zero.")
    x, y, z = (v / length for v in numbers)
    return x, y, z


Triple = tuple[float, float, float]

Length = Annotated[float, scalar("m", "not negative")]
PositiveLength = Annotated[float, scalar("m", "positive")]
Density = Annotated[float, scalar("kg/m3", "not negative")]
Modulus = Annotated[float, scalar("Pa", "positive")]
Angle = Annotated[float, scalar("rad")]
Time = Annotated[float, scalar("s")]
Share = Annotated[float, deviation("%")]
Position = Annotated[Triple, vector("m")]
Extent = Annotated[Triple, vector("m", "positive")]
Acceleration = Annotated[Triple, vector("m/s2")]
RotationVector = Annotated[Triple, vector("rad")]
Direction = Annotated[Triple, BeforeValidator(parse_direction)]

Names = Annotated[
    tuple[str, ...],
    BeforeValidator(lambda value: [value] if isinstance(value, str) else value),
]
"""One name, or a list of them."""
