"""The table [uncertain]: how well everything is known that is not calibrated."""

import re
from collections.abc import Callable
from dataclasses import fields
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, create_model

from softcal_jax.fields import Uncertain
from softcal_jax.project._quantities import dimension_of, is_number, scalar, shown
from softcal_jax.project._table import Number, Table

_PERCENT = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*%\s*")


def _parser(unit: str, *, estimated: bool) -> Callable[[Any], float | str]:
    """Return a parser of values in an SI unit or in "%"; zero needs neither."""
    parse = _share if unit == "%" else scalar(dimension_of(unit), "not negative")

    def parsed(value: Any) -> float | str:
        if is_number(value) and value == 0:
            return 0.0
        return value if estimated and value == "estimated" else parse(value)

    return parsed


def _share(value: Any) -> float:
    match = _PERCENT.fullmatch(value) if isinstance(value, str) else None
    if not match:
        raise ValueError(f'got {shown(value)}; expected a share, like "3 %".')
    return 0.01 * float(match[1])


ShareOrEstimated = Annotated[
    float | Literal["estimated"], BeforeValidator(_parser("%", estimated=True))
]


def _type_of(kind: Any, unit: str) -> Any:
    if not unit:
        return Annotated[Number, Field(ge=0, allow_inf_nan=False)]
    return Annotated[kind, BeforeValidator(_parser(unit, estimated=kind is not float))]


_KEYS: dict[str, Any] = {
    field.name: (_type_of(field.type, field.metadata["unit"]), field.default)
    for field in fields(Uncertain)
}


class UncertainTable(create_model("UncertainTable", __base__=Table, **_KEYS)):
    """Its keys are the fields of `Uncertain`, whose docstring explains them."""
