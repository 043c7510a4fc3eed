"""What else is known only roughly: the kinds of [[setup]], and [uncertain].

Both are made from `softcal_jax.fields.KINDS`; to add a kind, write a row there.
"""

import dataclasses
import re
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, create_model

from softcal_jax import fields
from softcal_jax.project import _quantities as typed
from softcal_jax.project._problems import known_name
from softcal_jax.project._quantities import (
    dimension_of,
    is_number,
    parse_in_si,
    scalar,
    shown,
)
from softcal_jax.project._table import Choice, Table, WholeFile, by_keys

_PERCENT = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*%\s*")


def _parser(unit: str, *, estimated: bool) -> Callable[[Any], float | str]:
    """Return a parser of values in an SI unit or in "%"; zero needs neither."""
    parse = parse_share if unit == "%" else scalar(dimension_of(unit), "not negative")

    def parsed(value: Any) -> float | str:
        if is_number(value) and value == 0:
            return 0.0
        return value if estimated and value == "estimated" else parse(value)

    return parsed


def parse_share(value: Any) -> float:
    """Parse a share of a value, "3 %"; raise ValueError if it is none."""
    match = _PERCENT.fullmatch(value) if isinstance(value, str) else None
    if not match:
        raise ValueError(f'got {shown(value)}; expected a share, like "3 %".')
    return 0.01 * float(match[1])


ShareOrEstimated = Annotated[
    float | Literal["estimated"], BeforeValidator(_parser("%", estimated=True))
]


Share = Annotated[float, BeforeValidator(_parser("%", estimated=False))]


def _type_of(kind: Any, unit: str) -> Any:
    if not unit:
        return Annotated[typed.Number, Field(ge=0, allow_inf_nan=False)]
    return Annotated[kind, BeforeValidator(_parser(unit, estimated=kind is not float))]


_KEYS: dict[str, Any] = {
    field.name: (_type_of(field.type, field.metadata["unit"]), field.default)
    for field in dataclasses.fields(fields.Uncertain)
}


class UncertainTable(create_model("UncertainTable", __base__=Table, **_KEYS)):
    """Its keys are the fields of `Uncertain`, whose docstring explains them."""


class SetupTable(Table):
    """An error of the setup that is known up to a limit: a kind of `fields.KINDS`.

    Its keys are that of the kind, which says what it belongs to, and the arguments of
    the function of `fields` that makes its parameters.
    """

    kind: ClassVar[fields.Kind]

    limit: float | None = None
    prior_std: float | None = None

    @property
    def label(self) -> str:
        return self.kind.name

    def build(self, project: WholeFile) -> list[fields.Entry]:
        kind = self.kind
        arguments = self.model_dump(exclude={kind.name, "each"})
        if kind.each:
            arguments |= _scope(project, vars(self)["each"])
        of: list[tuple[Any, ...]] = [()]
        if kind.noun:
            of = [(name,) for name in getattr(self, kind.name)]
        if kind.subjects is not None:
            subjects = {subject[0]: subject for subject in kind.subjects(project)}
            for (name,) in of:
                known_name(kind.noun, name, subjects, kind.section)
            of = [subjects[name] for (name,) in of]
        made = [fields.FUNCTIONS[kind.name](*subject, **arguments) for subject in of]
        several = ([m] if isinstance(m, fields.Entry) else m for m in made)
        return [entry for entries in several for entry in entries]


Each = Annotated[
    Literal["configuration", "recording"] | tuple[str, ...],
    Choice(lambda value, kinds: kinds[1 if isinstance(value, list) else 0]),
]


def _scope(project: WholeFile, each: Each | None) -> dict[str, Any]:
    """Return the scope of an error that all share, or of which each has its own."""
    fitted = [c for c in project.configurations if c.role == "calibration"]
    if each == "configuration":
        return {"each": [c.name for c in fitted], "by": "configuration"}
    recordings = list(dict.fromkeys(c.recording or c.name for c in fitted))
    names = recordings if each == "recording" else each or ()
    for name in names:
        known_name("recording", name, recordings, "[[configurations]]")
    return {"each": names}


def _table(kind: fields.Kind) -> type[SetupTable]:
    keys: dict[str, Any] = {"each": (Each, None)} if kind.each else {}
    unnamed = lambda names: kind.unnamed if kind.unnamed and names is True else names
    names = Annotated[typed.Names, BeforeValidator(unnamed)]
    keys[kind.name] = (names if kind.noun else Literal[True], ...)
    for part in kind.parts:
        unit = "" if part.relative else part.unit
        size = Annotated[float | None, BeforeValidator(partial(_positive, unit=unit))]
        usual = None if len(kind.parts) > 1 else kind.limit if kind.relative else ...
        example = 'largest error looked for: "3 deg", "2 mm"'
        keys[f"{part.prefix}limit"] = (size, Field(usual, description=example))
        keys[f"{part.prefix}prior_std"] = (size, None)
    table = create_model("Setup", __base__=SetupTable, **keys)
    table.kind = kind
    return table


def _positive(value: Any, unit: str) -> float:
    number = parse_in_si(value, unit)
    if not number > 0.0:
        raise ValueError(f'got "{value}"; expected more than zero.')
    return number


_TABLES = [_table(fields.KINDS[name]) for name in fields.FUNCTIONS]

AnySetup = Annotated[SetupTable, Choice(lambda value, _: by_keys(value, _TABLES))]
