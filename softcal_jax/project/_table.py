"""What all tables of a project file share: how they are read, chosen and built."""

import dataclasses
import functools
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from types import UnionType
from typing import Annotated, Any, ClassVar, TypeVar, get_args, get_origin

import equinox as eqx
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    TypeAdapter,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_core import ErrorDetails, InitErrorDetails, core_schema

from softcal_jax.project import _quantities as typed
from softcal_jax.project._problems import MOST_PROBLEMS, known_here, one_of
from softcal_jax.project._quantities import dimension_of, shown

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
    """A table that makes an object, whose class says what the table is for.

    See `table_of`; `key_of` has the keys by the names of the fields.
    """

    makes: ClassVar[type[Any]]
    key_of: ClassVar[Mapping[str, str]]

    def arguments(self) -> dict[str, Any]:
        """Return the arguments that the table gives, by the names of the fields."""
        return {name: _built(getattr(self, key)) for name, key in self.key_of.items()}

    def build(self, *first: Any, **more: Any) -> Any:
        """Build the object; `first` are arguments before those of the table."""
        return self.makes(*first, **self.arguments() | more)


def _built(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_built, value))
    return value.build() if isinstance(value, Maker) else value


@functools.cache
def table_of(
    kind: type[Any], *given: str, base: type[Maker] = Maker, **by_hand: Any
) -> type[Maker]:
    """Make the table of a class from its fields, their types and metadata (`key`).

    Fields that are `given` by whoever builds it are no keys. The types `by_hand` are
    those of fields whose annotation does not say it, and of keys that are no fields.
    """
    hints, names = typing.get_type_hints(kind), {}
    own = {field.name for field in dataclasses.fields(kind)}
    keys: dict[str, Any] = {k: (t, ...) for k, t in by_hand.items() if k not in own}
    for field in dataclasses.fields(kind):
        if field.name in given:
            continue
        names[field.name] = key = field.metadata.get("key", field.name)
        annotation = by_hand.get(field.name)
        if annotation is None:
            annotation = type_of(hints[field.name], field.metadata)
        default: Any = {"default": field.default}
        if field.default_factory is not dataclasses.MISSING:
            default = {"default_factory": annotation}  # an empty table of a part
        elif field.default is dataclasses.MISSING or field.metadata.get("required"):
            default = {}
        words = field.metadata.get("words") or None
        keys[key] = annotation, Field(**default, description=words)
    table = create_model(kind.__name__, __base__=base, **keys)
    table.makes, table.key_of = kind, names
    return table


def type_of(hint: Any, metadata: Mapping[str, Any]) -> Any:
    """Return the type by which a file gives a field: its annotation, with its unit.

    Of a union the first type counts; the others are for Python only.
    """
    kind, unit = _first(hint), metadata.get("unit")
    entry = _first(get_args(kind)[0]) if get_origin(kind) is tuple else None
    if unit is None:
        if entry is str:
            return typed.Names
        if entry is not None:
            table, bare = table_of(entry), metadata.get("bare")
            whole = lambda v: {bare: v} if bare and not isinstance(v, dict) else v
            return tuple[Annotated[table, BeforeValidator(whole)], ...]
        if isinstance(kind, type) and issubclass(kind, eqx.Module):
            return table_of(kind)
        return {bool: typed.Flag, int: typed.Integer}.get(kind, kind)
    shape = "3" if entry is float else getattr(kind, "dim_str", "")
    if not unit:
        axes = {"3": typed.Direction, "3 3": tuple[(typed.Direction,) * 3]}
        return axes.get(shape, typed.Number)
    result, parser = float, typed.scalar
    if shape == "3":
        result, parser = typed.Triple, typed.vector
    parse = parser(dimension_of(unit), metadata["size"])
    return Annotated[result, BeforeValidator(parse)]


def _first(hint: Any) -> Any:
    union = get_origin(hint) in (typing.Union, UnionType)
    return get_args(hint)[0] if union else hint


_adapter = functools.cache(TypeAdapter)


@dataclass(frozen=True)
class Choice:
    """Mark a type that a function of the value, and members of a union, chooses.

    pydantic's own unions would add the name of the member to the place of an error. The
    function raises ValueError where none fits.
    """

    choose: Callable[[Any, Sequence[Any]], Any]

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        kinds = get_args(source)

        def validate(value: Any, info: Any) -> Any:
            adapter = _adapter(self.choose(value, kinds))
            return adapter.validate_python(value, context=info.context)

        return core_schema.with_info_plain_validator_function(validate)


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


def only(kind: type[Any]) -> Choice:
    """Choose the table of a class, whatever the value."""
    return Choice(lambda *_: table_of(kind))


def of_type(
    kinds: Mapping[str, type[Any]],
    table: Callable[[type[Any]], type[Table]] = lambda kind: table_of(kind, type=str),
) -> Choice:
    """Choose the table of the class that has the `type` of the value."""

    def choose(value: Any, _: Any) -> type[Table]:
        raw = as_table(value)
        kind = kinds.get(str(raw.get("type")))
        if kind is None:
            raise wrong_choice("type", raw, kinds)
        return kind if issubclass(kind, Table) else table(kind)

    return Choice(choose)


def by_keys(value: Any, kinds: Sequence[type[Any]]) -> type[Any]:
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
