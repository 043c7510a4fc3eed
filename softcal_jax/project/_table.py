"""What all tables of a project file share: how they are read, chosen and built."""

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Annotated, Any, ClassVar, TypeVar, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from pydantic_core import ErrorDetails, InitErrorDetails, core_schema

from softcal_jax.project._problems import MOST_PROBLEMS, known_here, one_of
from softcal_jax.project._quantities import shown

T = TypeVar("T")
V = TypeVar("V")


class Table(BaseModel):
    """A table of the file; unknown keys are errors, which list those that it has."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="wrap")
    @classmethod
    def _name_keys(cls, raw: Any, handler: Callable[[Any], Any]) -> Any:
        try:
            return handler(raw)
        except ValidationError as error:
            # More are not listed, and each suggests a name.
            first = islice(error.errors(), MOST_PROBLEMS + 1)
            problems = [cls._in_words(details) for details in first]
            raise ValidationError.from_exception_data(cls.__name__, problems) from None

    @classmethod
    def _in_words(cls, details: ErrorDetails) -> InitErrorDetails:
        """List the keys there are if one is unknown; describe a missing one."""
        kind = details["type"]
        if len(details["loc"]) != 1 or kind not in ("extra_forbidden", "missing"):
            return details  # pyright: ignore[reportReturnType] (it has more keys)
        key = str(details["loc"][0])
        if kind == "missing":
            what = cls.model_fields[key].description
            return _at(key, f"missing. Expected {what}." if what else "missing.")
        known = known_here(key, cls.model_fields, "Known here")
        return _at(key, f"unknown key.{cls.foreign(key)}{known}")

    @classmethod
    def foreign(cls, key: str) -> str:
        """Say where an unknown key belongs, in a sentence after a space."""
        return ""


def _at(key: str, text: str) -> InitErrorDetails:
    error = {"error": ValueError(text)}
    return InitErrorDetails(type="value_error", loc=(key,), input=None, ctx=error)


class Maker(Table):
    """A table that makes an object; its keys except `type` are the arguments in order.

    Keys `by_name` are arguments by name instead. The docstring of the class that it
    `makes` says what the table is for.
    """

    makes: ClassVar[type[Any]]
    by_name: ClassVar[tuple[str, ...]] = ()

    def build(self, *first: Any, **more: Any) -> Any:
        """Build the object; `first` are arguments before those of the table."""
        arguments = {key: _built(value) for key, value in self if key != "type"}
        named = {key: arguments.pop(key) for key in self.by_name}
        return self.makes(*first, *arguments.values(), **named, **more)


def _built(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_built, value))
    return value.build() if isinstance(value, Maker) else value


_adapter = functools.cache(TypeAdapter)


@dataclass(frozen=True)
class Choice:
    """Mark a union whose member is chosen by a function of the value and the members.

    The members of a table are all that derive from it. pydantic's own unions would add
    the name of the member to the place of an error. The function raises ValueError
    where no member fits.
    """

    choose: Callable[[Any, Sequence[Any]], Any]

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        kinds = get_args(source) or _members(source)

        def validate(value: Any, info: Any) -> Any:
            adapter = _adapter(self.choose(value, kinds))
            return adapter.validate_python(value, context=info.context)

        return core_schema.with_info_plain_validator_function(validate)


def _members(source: Any) -> list[type[Table]]:
    if not (isinstance(source, type) and issubclass(source, Table)):
        return []
    below = [kind for table in source.__subclasses__() for kind in _members(table)]
    return below or [source]


TableOr = Annotated[
    T | V, Choice(lambda value, kinds: kinds[0 if isinstance(value, dict) else 1])
]
"""A table, or else a list or text."""


def wrong_key(key: str, text: str) -> ValidationError:
    """Build the error of a key whose value decides the schema of a table."""
    return ValidationError.from_exception_data("Table", [_at(key, text)])


def wrong_choice(
    key: str, table: Mapping[str, Any], names: Iterable[str]
) -> ValidationError:
    """Build the error of a table where the value of a key is none of the `names`."""
    value = table.get(key, "")
    got = f"got {shown(value)}" if key in table else "missing"
    return wrong_key(key, f"{got}; expected {one_of(str(value), names)}")


def by_type(value: Any, kinds: Sequence[type[BaseModel]]) -> type[BaseModel]:
    """Choose the table that has the `type` of the value, for a `Choice`."""
    tables = {get_args(k.model_fields["type"].annotation)[0]: k for k in kinds}
    table = as_table(value)
    chosen = tables.get(str(table.get("type")))
    if chosen is None:
        raise wrong_choice("type", table, tables)
    return chosen


def by_keys(value: Any, kinds: Sequence[type[BaseModel]]) -> type[BaseModel]:
    """Choose the table with the most of its own required keys present, for a `Choice`.

    Among equals, the one with all of its keys present is chosen. If several remain, a
    ValueError lists the choices.
    """
    table = as_table(value)
    common = set.intersection(*(set(kind.model_fields) for kind in kinds))
    needed = [
        [k for k, field in kind.model_fields.items() if field.is_required()]
        for kind in kinds
    ]
    needed = [[key for key in keys if key not in common] for keys in needed]
    present = [sum(key in table for key in keys) for keys in needed]
    rank = [(n, n == len(keys)) for n, keys in zip(present, needed, strict=True)]
    if rank.count(max(rank)) == 1:
        return kinds[rank.index(max(rank))]
    every = [key for keys in needed for key in keys]
    given = " and ".join(key for key in table if key in every) or "none"
    choices = ", ".join(" and ".join(keys) for keys in needed)
    raise ValueError(f"expected exactly one of {choices}; got {given}.")


def as_table(value: Any) -> dict[str, Any]:
    """Return a value that must be a table; raise ValueError if it is none."""
    if not isinstance(value, dict):
        raise ValueError(f"got {shown(value)}; expected a table.")
    return value


WholeFile = Any
"""A `ProjectTable`, whose own tables read others of it, without a circular import."""
