"""The table [uncertain]: how well everything is known that is not calibrated."""

import math
import re
from typing import Any, Literal

from pydantic import field_validator

from softcal_jax.fields import Uncertain
from softcal_jax.project._quantities import (
    ANGLE,
    LENGTH,
    Dimension,
    parse_scalar,
    shown,
)
from softcal_jax.project._table import Number, Table

_OF_KEY = {
    "gravity": ANGLE,
    "zeros": ANGLE,
    "clamp": LENGTH,
    "recordings": LENGTH,
    "mountings": LENGTH,
}
"""Dimensions of standard deviations that are not relative."""

ESTIMATED = "estimated"
"""What a component of the noise is called that the residuals are asked for."""

_PERCENT = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*%\s*")


class UncertainTable(Table):
    """Standard deviations; missing ones keep their defaults, and 0 switches one off."""

    nu: Number | None = None
    density: float | None = None
    gravity: float | None = None
    loads: float | None = None
    actuators: float | None = None
    clamp: float | None = None
    supports: float | None = None
    recordings: float | Literal["estimated"] | None = None
    zeros: float | None = None
    mountings: float | None = None
    mesh: Number | None = None

    @field_validator(*_OF_KEY, mode="before")
    @classmethod
    def _parse_dimensional(cls, value: Any, info: Any) -> float | str:
        if info.field_name == "recordings" and value == ESTIMATED:
            return value
        return _not_negative(_quantity(value, _OF_KEY[info.field_name]), value)

    @field_validator("density", "loads", "actuators", "supports", mode="before")
    @classmethod
    def _parse_relative(cls, value: Any) -> float:
        return parse_share(value)

    @field_validator("nu", "mesh")
    @classmethod
    def _check_number(cls, value: float | None) -> float | None:
        return value if value is None else _not_negative(value, value)

    def build(self) -> Uncertain:
        """Return the standard deviations, in SI units."""
        return Uncertain(**self.model_dump(exclude_none=True))


def parse_share(value: Any) -> float:
    """Parse a share like "3 %"; a plain zero needs no unit."""
    match = _PERCENT.fullmatch(value) if isinstance(value, str) else None
    if match:
        return 0.01 * float(match[1])
    if value == 0 and not isinstance(value, bool | str):
        return 0.0
    raise ValueError(f'got {shown(value)}; expected a share, like "3 %".')


def _quantity(value: Any, dimension: Dimension) -> float:
    """Parse a quantity; a plain zero needs no unit."""
    if value == 0 and not isinstance(value, bool | str):
        return 0.0
    return parse_scalar(value, dimension)


def _not_negative(number: float, value: Any) -> float:
    if not 0.0 <= number < math.inf:
        raise ValueError(f"got {shown(value)}; expected zero or more, and finite.")
    return number
