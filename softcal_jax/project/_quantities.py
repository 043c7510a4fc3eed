"""Parse quantities of a project file, like "200 kPa" and "(0, 0, -1) N"."""

import functools
import math
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import pint
from pydantic_core import PydanticCustomError

from softcal_jax._names import METRES, suggestion


class Dimension(NamedTuple):
    """Physical dimension of a quantity.

    Attributes:
        name: Its name in messages, with the article.
        si: SI unit of the parsed number.
        example: A value as a user would write it.
        usual: Units to suggest for a misspelt one.
    """

    name: str
    si: str
    example: str
    usual: tuple[str, ...]


LENGTH = Dimension("a length", "m", "100 mm", tuple(METRES))
PRESSURE = Dimension(
    "a pressure or modulus",
    "Pa",
    "200 kPa",
    ("Pa", "kPa", "MPa", "GPa", "N/m^2", "N/mm^2"),
)
DENSITY = Dimension(
    "a density", "kg/m^3", "1070 kg/m^3", ("kg/m^3", "g/cm^3", "kg/dm^3")
)
FORCE = Dimension("a force", "N", "0.51 N", ("N", "mN", "kN", "kgf"))
ACCELERATION = Dimension("an acceleration", "m/s^2", "9.81 m/s^2", ("m/s^2", "mm/s^2"))
ANGLE = Dimension("an angle", "rad", "20 deg", ("deg", "rad", "mrad"))

MASS = Dimension("a mass", "kg", "10 g", ("kg", "g", "mg"))
VOLUME = Dimension("a volume", "m^3", "2 ml", ("ml", "mm^3", "cm^3", "l", "m^3"))
TORQUE = Dimension("a torque", "N*m", "50 N*mm", ("N*m", "N*mm", "mN*m"))
BEDDING = Dimension("a stiffness per area", "Pa/m", "1 GPa/m", ("N/mm^3", "GPa/m"))

OF_UNIT = {
    "m": LENGTH,
    "m3": VOLUME,
    "rad": ANGLE,
    "N": FORCE,
    "Pa": PRESSURE,
    "N m": TORQUE,
    "kg/m3": DENSITY,
    "N/m3": BEDDING,
}
"""Dimension of each SI unit, as laws, actuators and effectors name it."""


def dimension_of(unit: str) -> Dimension:
    """Return the dimension of an SI unit; unlisted units make one of their own."""
    own = Dimension(f"a quantity in {unit}", _spelt(unit), f"1 {unit}", (unit,))
    return OF_UNIT.get(unit, own)


# pint treats angles as plain numbers, so it would accept "20 %" as an angle.
_ANGLES = ("degree", "radian", "milliradian", "turn")

_NUMBER = r"[+-]?(?:inf|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
_NAME = r"[A-Za-zµμ°%]+(?:(?:\^|\*\*)?-?\d+|[²³])?"
# Only products and quotients of named units reach pint's own parser.
_UNIT = re.compile(rf"{_NAME}(?:\s*[*/·]\s*{_NAME})*")
_SCALAR = re.compile(rf"\s*({_NUMBER})\s*(.*?)\s*")
_VECTOR = re.compile(r"\s*[(\[](.*)[)\]]\s*(.*?)\s*")


@functools.cache
def _registry() -> pint.UnitRegistry:
    # Built on first use: pint takes a tenth of a second to read its definitions.
    return pint.UnitRegistry()


def _wrong(problem: str, **context: Any) -> PydanticCustomError:
    return PydanticCustomError("quantity", "{problem}", {"problem": problem, **context})


def _spelt(unit: str) -> str:
    """Spell a unit as pint reads it: people write "m3" for "m^3"."""
    return re.sub(r"(?<=[A-Za-zµμ])(-?\d)", r"^\1", unit).replace("·", "*")


@functools.cache
def unit_factor(unit: str, dimension: Dimension) -> float:
    """Compute the value of one `unit` in SI.

    Raises:
        PydanticCustomError: If the unit is unknown or measures something else.
    """
    expected = f'expected {dimension.name}, like "{dimension.example}"'
    if not _UNIT.fullmatch(unit):
        raise _wrong(f'cannot read the unit "{unit}"; {expected}.')
    registry = _registry()
    try:
        one = registry.Quantity(1.0, registry.parse_units(_spelt(unit)))
    except pint.UndefinedUnitError as error:
        hint = suggestion(unit, dimension.usual, quote='"')
        raise _wrong(f'unknown unit "{unit}"; {expected}.{hint}') from error
    fits = one.is_compatible_with(dimension.si)
    if not fits or (dimension is ANGLE and str(one.units) not in _ANGLES):
        raise _wrong(f'"{unit}" is not {dimension.name}; {expected}.')
    return float(one.to(dimension.si).magnitude)


def _bare(value: Any, dimension: Dimension) -> PydanticCustomError:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return _wrong(
            f"{value} has no unit; expected {dimension.name}, in quotes and with its "
            f'unit, like "{dimension.example}".'
        )
    return _wrong(
        f"got {_shown(value)}; expected {dimension.name} in quotes, like "
        f'"{dimension.example}".'
    )


def _shown(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)


def parse_scalar(value: Any, dimension: Dimension) -> float:
    """Parse a quantity like "200 kPa" into SI units.

    Args:
        value: The value in the file.
        dimension: Its dimension.

    Raises:
        PydanticCustomError: If it is not such a quantity; the text shows an example.
    """
    match = _SCALAR.fullmatch(value) if isinstance(value, str) else None
    if match is None or not match[2]:
        number = float(match[1]) if match else value
        raise _bare(int(number) if _is_whole(number) else number, dimension)
    try:
        return float(match[1]) * unit_factor(match[2], dimension)
    except PydanticCustomError as error:
        raise _wrong(f'"{value}": {error.message()}') from error


def parse_in_si(value: Any, unit: str) -> float:
    """Parse a value of a project file into SI.

    Args:
        value: "200 kPa", or a plain number where there is no unit.
        unit: SI unit; empty for a plain number.

    Raises:
        ValueError: If it is not such a value; the text shows an example.
    """
    if unit:
        try:
            return parse_scalar(value, dimension_of(unit))
        except PydanticCustomError as error:
            raise ValueError(error.message()) from error
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"got {value!r}; expected a number, like 0.45.")
    return float(value)


def parse_either(
    value: Any, dimensions: Sequence[Dimension], what: str
) -> tuple[float, Dimension]:
    """Parse a quantity of one of several dimensions into SI, and tell which it is.

    Args:
        value: The value in the file.
        dimensions: Possible dimensions.
        what: What is expected, for messages.

    Raises:
        PydanticCustomError: If it has none of the dimensions.
    """
    for dimension in dimensions:
        try:
            return parse_scalar(value, dimension), dimension
        except PydanticCustomError:
            continue
    raise _wrong(f"got {_shown(value)}; expected {what}.")


def _is_whole(value: Any) -> bool:
    return isinstance(value, float) and value.is_integer()


def parse_vector(value: Any, dimension: Dimension) -> tuple[float, float, float]:
    """Parse three quantities: "(0, 15, 36) mm" or ["0 mm", "15 mm", "36 mm"].

    Args:
        value: The value in the file.
        dimension: Dimension of each component.

    Raises:
        PydanticCustomError: If it is not such a vector; the text shows an example.
    """
    unit = dimension.example.split()[-1]
    example = f'"(0, 0, -1) {unit}"'
    expected = f"expected three numbers with a unit, like {example}"
    if isinstance(value, list):
        parts = [parse_scalar(part, dimension) for part in value]
    elif isinstance(value, str):
        parts = _vector_of_text(value, dimension, expected)
    else:
        raise _wrong(f"got {_shown(value)}; {expected}.")
    if len(parts) != 3:
        raise _wrong(f"got {len(parts)} numbers; {expected}.")
    x, y, z = parts
    return x, y, z


def _vector_of_text(value: str, dimension: Dimension, expected: str) -> list[float]:
    match = _VECTOR.fullmatch(value)
    if match is None:
        raise _wrong(f'got "{value}"; {expected}.')
    if not match[2]:
        raise _wrong(f'"{value}" has no unit; {expected}.')
    numbers = [part.strip() for part in match[1].split(",")]
    for number in numbers:
        if not re.fullmatch(_NUMBER, number):
            raise _wrong(f'"{value}": "{number}" is not a number; {expected}.')
    try:
        factor = unit_factor(match[2], dimension)
    except PydanticCustomError as error:
        raise _wrong(f'"{value}": {error.message()}') from error
    return [float(number) * factor for number in numbers]


def scalar(dimension: Dimension) -> Callable[[Any], float]:
    """Return a parser of quantities of one dimension."""
    return functools.partial(parse_scalar, dimension=dimension)


def vector(dimension: Dimension) -> Callable[[Any], tuple[float, float, float]]:
    """Return a parser of vectors of one dimension."""
    return functools.partial(parse_vector, dimension=dimension)


def parse_direction(value: Any) -> tuple[float, float, float]:
    """Parse a unit vector from "-z" or [0, 0, -1].

    Raises:
        ValueError: If it has no direction.
    """
    if isinstance(value, str):
        axis = re.fullmatch(r"([+-]?)([xyz])", value.strip())
        if axis is None:
            raise ValueError(f'got "{value}"; expected "-z" or [0, 0, -1].')
        sign = -1.0 if axis[1] == "-" else 1.0
        x, y, z = (sign * (letter == axis[2]) for letter in "xyz")
        return x, y, z
    numbers = value if isinstance(value, list) else []
    if len(numbers) != 3 or not all(type(v) in (int, float) for v in numbers):
        raise ValueError(f'got {value}; expected "-z" or [0, 0, -1].')
    length = math.hypot(*numbers)
    if not 0.0 < length < math.inf:
        raise ValueError(f"got {value}; a direction has a finite length above zero.")
    x, y, z = (v / length for v in numbers)
    return x, y, z
