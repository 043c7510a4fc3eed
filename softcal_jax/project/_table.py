"""What all tables of a project file share: how they are read, chosen and built.

Errors of a project file in words: the key, what it needs, the closest match.
"""

import contextlib
import dataclasses
import functools
import inspect
import re
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    NamedTuple,
    TypeVar,
    get_args,
    get_origin,
)

import equinox as eqx
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    StrictBool,
    StrictFloat,
    StrictInt,
    TypeAdapter,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_core import ErrorDetails, InitErrorDetails, core_schema

from softcal_jax import _text
from softcal_jax._text import shortened, with_short_names
from softcal_jax.project import _quantities as typed
from softcal_jax.project._quantities import shown

_EXPECTED = {
    "string_type": "a text in quotes",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "greater_than": "more than {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than": "less than {lt:g}",
    "too_short": "at least {min_length}",
    "tuple_type": "a list in [ ]",
    "dict_type": "a table",
    "model_type": "a table",
}

MOST_PROBLEMS = 30
"""Most problems that are listed; a file with more is hardly a project file."""


class ProjectError(ValueError):
    """Something in a project file is wrong; nothing was solved or written."""


def one_by_one(path: Path, problems: Iterable[str]) -> ProjectError:
    """Build the error that lists the problems of a file, one per line."""
    problems = list(dict.fromkeys(map(with_short_names, problems)))
    if len(problems) == 1:
        return ProjectError(f"{path}: {problems[0]}")
    number = str(len(problems))
    if len(problems) > MOST_PROBLEMS:
        number = f"more than {MOST_PROBLEMS}"
        problems = [*problems[:MOST_PROBLEMS], "..."]
    listed = "".join(f"\n- {problem}" for problem in problems)
    return ProjectError(f"{path}: {number} problems.{listed}")


class WrongKeyError(ValueError):
    """Something is wrong at a key, relative to the table being read."""

    def __init__(self, key: str, problem: object):
        super().__init__(f"{key}: {problem}")
        self.key, self.problem = key, problem


@contextlib.contextmanager
def under(key: str) -> Iterator[None]:
    """Prefix errors raised inside, and their keys, with a key."""
    try:
        yield
    except ProjectError:
        raise
    except WrongKeyError as error:
        raise WrongKeyError(f"{key}.{error.key}", error.problem) from error
    except (ValueError, OSError, ImportError) as error:
        raise WrongKeyError(key, error) from error


@contextlib.contextmanager
def in_file(path: Path) -> Iterator[None]:
    """Turn key errors raised inside into errors of a file."""
    try:
        yield
    except WrongKeyError as error:
        raise ProjectError(f"{path}: {with_short_names(str(error))}") from error


@contextlib.contextmanager
def at(path: Path, key: str) -> Iterator[None]:
    """Prefix errors raised inside with a file and a key."""
    with in_file(path), under(key):
        yield


def describe(error: ValidationError, raw: dict[str, Any]) -> list[str]:
    """Write one message, with the path of its key, for each problem pydantic found.

    `raw` is the file as it was read, before [shared] is merged.
    """
    return [
        f"{key_path(details['loc'], raw) or 'file'}: {_in_words(details)}"
        for details in error.errors()
    ]


def _in_words(details: ErrorDetails) -> str:
    kind, value, context = details["type"], details["input"], details.get("ctx", {})
    if kind == "value_error":
        return str(context["error"])
    if kind == "missing":
        return "missing; the list is too short."
    got = f"got {shown(value)}; expected "
    if kind == "literal_error":
        # pydantic writes them as 'a', 'b' or 'c'.
        choices = re.findall("'([^']*)'", context["expected"])
        if not choices:  # true, or numbers
            return f"{got}{context['expected'].lower()}."
        return got + one_of(str(value), choices)
    if kind == "too_long":
        return f"expected {context['max_length']} values, got {len(value)}."
    if kind in _EXPECTED:
        return f"{got}{_EXPECTED[kind].format(**context)}."
    return f"{got}{details['msg'].removeprefix('Input should be ')}."


def one_of(value: str, known: Iterable[str]) -> str:
    """List the known choices, and suggest the one closest to a value."""
    known = list(known)
    listed = ", ".join(f'"{name}"' for name in known)
    return f"one of {listed}.{suggestion(value, known)}"


def suggestion(name: str, known: Iterable[str]) -> str:
    """Suggest the closest known name, in the quotes of project files."""
    return _text.suggestion(name, known, quote='"')


def known_here(name: str, known: Iterable[str], words: str = "Known") -> str:
    """Suggest the closest known name, and list all, in sentences after a space."""
    return f"{suggestion(name, known)} {words}: {', '.join(known)}."


def known_name(kind: str, name: str, known: Iterable[str], section: str) -> None:
    """Raise ValueError unless a name is known; `section` is where these stand."""
    known = list(known)
    if name not in known:
        none = f" The project has none: add one to {section}."
        hint = known_here(name, known) if known else none
        raise ValueError(f'there is no {kind} "{name}".{hint}')


def key_path(keys: tuple[str | int, ...], raw: dict[str, Any]) -> str:
    """Join keys to a path; an entry of a list goes by its name, or counts from 1."""
    posed = keys[:1] in (("configurations",), ("candidates",))
    if posed and len(keys) > 2 and functools.reduce(_step, keys, raw) is None:
        shared = ("shared", *keys[2:])
        keys = keys if functools.reduce(_step, shared, raw) is None else shared
    out, value = "", raw
    for key in keys:
        value = _step(value, key)
        if isinstance(key, str):
            out += f".{shortened(key)}" if out else shortened(key)
        else:
            table = value if isinstance(value, dict) else {}
            name = table.get("name") or table.get("field")
            out += f".{name}" if isinstance(name, str) else f"[{key + 1}]"
    return out


def _step(value: Any, key: str | int) -> Any:
    """Return what a table or a list has at a key; None if nothing."""
    if isinstance(value, dict):
        return value.get(key)
    if isinstance(value, list) and isinstance(key, int) and key < len(value):
        return value[key]
    return None


T = TypeVar("T")
V = TypeVar("V")


class Table(BaseModel):
    """A table of the file; unknown keys are errors, which list those that it has.

    `foreign` says where such a key belongs, in a sentence after a space.
    """

    foreign: ClassVar[Callable[[str], str]] = staticmethod(lambda key: "")
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


def _at(key: str, text: str) -> InitErrorDetails:
    error = {"error": ValueError(text)}
    return InitErrorDetails(type="value_error", loc=(key,), input=None, ctx=error)


class Context(NamedTuple):
    """What tables are read with: the folder of the file, and the table of its law.

    The latter is None if the law is unknown.
    """

    folder: Path
    material: Any = None


def _in_folder(value: Any, info: Any) -> Path:
    if not isinstance(value, str):
        raise ValueError(f"got {shown(value)}; expected a text in quotes.")
    return info.context.folder / value


File = Annotated[Path, BeforeValidator(_in_folder)]
"""A file that a project file names, relative to itself; as read, with its folder."""


class Maker(Table):
    """A table that makes an object, by its class or by a function.

    See `table_of`; `key_of` has the keys by the names of the fields.
    """

    makes: ClassVar[Any]
    key_of: ClassVar[Mapping[str, str]]

    def arguments(self) -> dict[str, Any]:
        """Return the arguments that the table gives, by the names of the fields."""
        return {name: built(getattr(self, key)) for name, key in self.key_of.items()}

    def build(self, *first: Any, **more: Any) -> Any:
        """Build the object; `first` are arguments before those of the table."""
        return self.makes(*first, **self.arguments() | more)


def built(value: Any) -> Any:
    """Build the object of a table, or of each in a list; keep any other value."""
    if isinstance(value, tuple):
        return tuple(map(built, value))
    return value.build() if isinstance(value, Maker) else value


@functools.cache
def table_of(
    makes: Callable[..., Any], *given: str, base: type[Maker] = Maker, **by_hand: Any
) -> type[Maker]:
    """Make the table of a class or a function from its fields, see `fields_of`.

    Fields that are `given` by whoever builds it are no keys. The types `by_hand` are
    those of fields whose annotation does not say it, and of keys that are no fields.
    """
    names: dict[str, str] = {}
    fields = {field.name: (field, hint) for field, hint in fields_of(makes)}
    keys: dict[str, Any] = {k: (t, ...) for k, t in by_hand.items() if k not in fields}
    for name, (field, hint) in fields.items():
        if name not in given:
            names[name] = key = field.metadata.get("key", name)
            annotation = by_hand.get(name) or type_of(hint, field.metadata)
            keys[key] = annotation, entry_of(field, annotation)
    table = create_model(makes.__name__, __base__=base, **keys)
    # Static, so that a function is no method of the table.
    table.makes, table.key_of = staticmethod(makes), names
    return table


def fields_of(makes: Callable[..., Any]) -> Iterator[tuple[dataclasses.Field, Any]]:
    """Yield the fields of a class, or the `keys` of a function, with their types."""
    hints = typing.get_type_hints(makes, include_extras=True)
    if isinstance(makes, type):
        yield from ((field, hints[field.name]) for field in dataclasses.fields(makes))
        return
    arguments = inspect.signature(makes).parameters
    for name, metadata in vars(makes)["keys"].items():
        usual = arguments[name].default
        if usual is inspect.Parameter.empty:
            usual = dataclasses.MISSING
        field: Any = dataclasses.field(default=usual, metadata=metadata)
        field.name = name
        yield field, hints[name]


def entry_of(field: dataclasses.Field, annotation: Any) -> Any:
    """Return the entry of a field in a table: its default and its words."""
    default: Any = {"default": field.default}
    if field.default_factory is not dataclasses.MISSING:
        default = {"default_factory": annotation}  # an empty table of a part
    elif field.default is dataclasses.MISSING or field.metadata.get("required"):
        default = {}
    return Field(**default, description=field.metadata.get("words") or None)


def type_of(hint: Any, metadata: Mapping[str, Any]) -> Any:
    """Return the type by which a file gives a field: its annotation, with its unit.

    Of a union the first type counts; the others are for Python only.
    """
    kind, unit = _first(hint), metadata.get("unit")
    several = get_origin(kind) in (tuple, Sequence)
    entry = _first(get_args(kind)[0]) if several else None
    if unit is None:
        if entry is str:
            return typed.Names
        if entry is not None:
            table, bare = table_of(entry), metadata.get("bare")
            whole = lambda v: {bare: v} if bare and not isinstance(v, dict) else v
            return tuple[Annotated[table, BeforeValidator(whole)], ...]
        if isinstance(kind, type) and issubclass(kind, eqx.Module):
            return table_of(kind)
        return {bool: StrictBool, int: StrictInt}.get(kind, kind)
    shape = "3" if entry is float else getattr(kind, "dim_str", "")
    if not unit:
        axes = {"3": typed.Direction, "3 3": tuple[(typed.Direction,) * 3]}
        return axes.get(shape, StrictFloat)
    if shape == "3":
        return Annotated[typed.Triple, typed.vector(unit, metadata["size"])]
    return Annotated[float, typed.scalar(unit, metadata["size"])]


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


def only(makes: Callable[..., Any], *given: str, **by_hand: Any) -> Choice:
    """Choose the table of a class or a function, whatever the value."""
    return Choice(lambda *_: table_of(makes, *given, **by_hand))


def of_type(
    kinds: Mapping[str, Callable[..., Any]],
    table: Callable[[Any], type[Table]] = lambda kind: table_of(kind, type=str),
) -> Choice:
    """Choose the table of what has the `type` of the value."""

    def choose(value: Any, _: Any) -> type[Table]:
        raw = as_table(value)
        kind = kinds.get(str(raw.get("type")))
        if kind is None:
            raise wrong_choice("type", raw, kinds)
        return table(kind)

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
