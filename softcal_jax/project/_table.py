"""What all tables of a project file share; values come out in SI units.

The description of each key is also what a message says about it when it is missing.
"""

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Strict

from softcal_jax.project._quantities import (
    ACCELERATION,
    ANGLE,
    DENSITY,
    FORCE,
    LENGTH,
    MASS,
    PRESSURE,
    parse_direction,
    scalar,
    vector,
)

Number = Annotated[float, Strict()]
Integer = Annotated[int, Strict()]
Flag = Annotated[bool, Strict()]
Triple = tuple[float, float, float]

Length = Annotated[float, BeforeValidator(scalar(LENGTH))]
Pressure = Annotated[float, BeforeValidator(scalar(PRESSURE))]
Density = Annotated[float, BeforeValidator(scalar(DENSITY))]
Angle = Annotated[float, BeforeValidator(scalar(ANGLE))]
Mass = Annotated[float, BeforeValidator(scalar(MASS))]
Position = Annotated[Triple, BeforeValidator(vector(LENGTH))]
Acceleration = Annotated[Triple, BeforeValidator(vector(ACCELERATION))]
Force = Annotated[Triple, BeforeValidator(vector(FORCE))]
Traction = Annotated[Triple, BeforeValidator(vector(PRESSURE))]
RotationVector = Annotated[Triple, BeforeValidator(vector(ANGLE))]
Direction = Annotated[Triple, BeforeValidator(parse_direction)]

Names = Annotated[
    tuple[str, ...],
    BeforeValidator(lambda value: [value] if isinstance(value, str) else value),
]
"""One name, or a list of them."""


class Table(BaseModel):
    """A table of the file; a key that it does not know is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def one_of(table: BaseModel, *keys: str) -> str:
    """The one key of some that is given.

    Raises:
        ValueError: If none is, or more than one.
    """
    given = [key for key in keys if getattr(table, key) is not None]
    if len(given) != 1:
        found = f"got {' and '.join(given)}" if given else "got none"
        raise ValueError(f"expected exactly one of {', '.join(keys)}; {found}.")
    return given[0]


def table_or_vector(value: Any) -> str:
    """Tag of a value that is a table or else a list or text."""
    return "(table)" if isinstance(value, dict) else "(vector)"
