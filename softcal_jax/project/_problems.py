"""Errors of a project file in words: the key, what it needs, the closest match."""

import contextlib
import functools
import re
import typing
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import UnionType
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel, Tag, ValidationError
from pydantic_core import ErrorDetails

from softcal_jax import _names
from softcal_jax.project._quantities import shown
from softcal_jax.project._table import own_keys

_UNIONS = (typing.Union, UnionType)

_EXPECTED = {
    "string_type": "a text in quotes",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "greater_than_equal": "at least {ge}",
    "tuple_type": "a list in [ ]",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
}


MOST_PROBLEMS = 30
"""Problems of a file that are listed; a file with more is not meant as one of ours."""


class ProjectError(ValueError):
    """Something in a project file is wrong; nothing was solved or written."""


def one_by_one(path: Path, problems: Iterable[str]) -> ProjectError:
    """Build the error that lists the problems of a file, one per line."""
    problems = list(dict.fromkeys(problems))
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
        """Join key and problem in the message."""
        super().__init__(f"{key}: {problem}")
        self.key, self.problem = key, problem


@contextlib.contextmanager
def under(key: str, typed: Mapping[str, str] | None = None) -> Iterator[None]:
    """Prefix errors raised inside, and their keys, with a key.

    What is `typed` there is quoted for each of its keys that an error names.
    """
    try:
        yield
    except ProjectError:
        raise
    except WrongKeyError as error:
        raise WrongKeyError(f"{key}.{error.key}", error.problem) from error
    except (ValueError, OSError, ImportError) as error:
        raise WrongKeyError(key, f"{error}{_quoted(str(error), typed)}") from error


def _quoted(problem: str, typed: Mapping[str, str] | None) -> str:
    """Quote what is typed for the keys that a problem names in other units."""
    quotes = [
        f"{key} = {shown(text)}"
        for key, text in (typed or {}).items()
        if re.search(rf"\b{re.escape(key)}\b", problem) and text not in problem
    ]
    return f" The file has {', '.join(quotes)}." if quotes else ""


@contextlib.contextmanager
def in_file(path: Path) -> Iterator[None]:
    """Turn key errors raised inside into errors of a file."""
    try:
        yield
    except WrongKeyError as error:
        raise ProjectError(f"{path}: {error}") from error


@contextlib.contextmanager
def at(path: Path, key: str) -> Iterator[None]:
    """Prefix errors raised inside with a file and a key."""
    with in_file(path), under(key):
        yield


def describe(
    error: ValidationError, schema: type[BaseModel], raw: dict[str, Any]
) -> list[str]:
    """Write one message, with the path of its key, for each problem pydantic found.

    `raw` is the file as it was read, before [shared] is merged.
    """
    return [_message(details, schema, raw) for details in error.errors()]


def _message(
    details: ErrorDetails, schema: type[BaseModel], raw: dict[str, Any]
) -> str:
    place, kind = _place(schema, details["loc"]), details["type"]
    where, key = key_path(place.keys, raw), str(place.keys[-1]) if place.keys else ""
    if kind == "extra_forbidden":
        known = list(place.table.model_fields)
        if len(place.keys) == 1 and "configurations" in known:
            known.append("shared")
        unknown = f"unknown key.{known_here(key, known, 'Known here')}"
        return f"{where}: {_belonging(key, place) or unknown}"
    if kind == "missing" and isinstance(place.keys[-1], int):
        return f"{where}: missing; the list is too short."
    if kind == "missing":
        field = place.table.model_fields.get(key)
        what = f" Expected {field.description}." if field and field.description else ""
        return f"{where}: missing.{what}"
    types = map(type_of, place.kinds)
    if kind == "union_tag_not_found":
        return f"{where}.type: missing. Expected {one_of('', types)}"
    if kind == "union_tag_invalid":
        tag = details.get("ctx", {})["tag"]
        return f'{where}.type: got "{tag}"; expected {one_of(tag, types)}'
    return f"{where or 'file'}: {_wrong_value(details)}"


def one_of(value: str, known: Iterable[str]) -> str:
    """List the known choices, and suggest the one closest to a value."""
    known = list(known)
    listed = ", ".join(f'"{name}"' for name in known)
    return f"one of {listed}.{suggestion(value, known)}"


def _belonging(key: str, place: "_Location") -> str | None:
    """Say which other kinds of table have a key; None if there are none."""
    owners = [_choice(k, place.kinds) for k in place.kinds if key in k.model_fields]
    if not owners:
        return getattr(place.table, "foreign", lambda key: None)(key)
    has = ", ".join(k for k in place.table.model_fields if k != "type")
    this = _choice(place.table, place.kinds)
    known = f"This is {this}, which has" if this else "Without these, it has"
    return f"{key} belongs to {' or '.join(owners)}. {known} {has}."


def type_of(kind: type[BaseModel]) -> str:
    """Return the `type` by which a file chooses a table."""
    (name,) = get_args(kind.model_fields["type"].annotation)
    return name


def _choice(kind: type[BaseModel], kinds: tuple[type[BaseModel], ...]) -> str:
    """Describe how a file chooses one of several kinds of tables."""
    if getattr(kind, "choice", ""):
        return kind.choice  # pyright: ignore[reportAttributeAccessIssue]
    if "type" in kind.model_fields:
        return f'type = "{type_of(kind)}"'
    return " and ".join(own_keys(kinds)[kinds.index(kind)])


def _wrong_value(details: ErrorDetails) -> str:
    kind, value, context = details["type"], details["input"], details.get("ctx", {})
    if kind == "value_error":
        return str(context["error"])
    got = f"got {shown(value)}; expected "
    if kind == "literal_error":
        # pydantic writes them as 'a', 'b' or 'c'.
        choices = re.findall("'([^']*)'", context["expected"])
        return got + one_of(str(value), choices)
    if kind == "too_long":
        return f"expected {context['max_length']} values, got {len(value)}."
    if kind in _EXPECTED:
        return f"{got}{_EXPECTED[kind].format(**context)}."
    return f"{got}{details['msg'].removeprefix('Input should be ')}."


def suggestion(name: str, known: Iterable[str]) -> str:
    """Suggest the closest known name, in the quotes of project files."""
    return _names.suggestion(name, known, quote='"')


def known_here(name: str, known: Iterable[str], words: str = "Known") -> str:
    """Suggest the closest known name, and list all, in sentences after a space."""
    return f"{suggestion(name, known)} {words}: {', '.join(known)}."


def known_name(kind: str, name: str, known: Iterable[str], section: str) -> None:
    """Raise ValueError unless a name is known; `section` says where they stand."""
    known = list(known)
    if name in known:
        return
    if not known:
        raise ValueError(
            f'there is no {kind} "{name}"; the project has none: add one to {section}.'
        )
    raise ValueError(f'there is no {kind} "{name}".{known_here(name, known)}')


def key_path(keys: tuple[str | int, ...], raw: dict[str, Any]) -> str:
    """Join keys to a path; an entry of a list goes by its name, or counts from 1."""
    posed = keys[:1] in (("configurations",), ("candidates",))
    if posed and len(keys) > 2 and functools.reduce(_step, keys, raw) is None:
        shared = ("shared", *keys[2:])
        keys = keys if functools.reduce(_step, shared, raw) is None else shared
    out, here = "", raw
    for key in keys:
        here = _step(here, key)
        if isinstance(key, str):
            out += f".{key}" if out else key
        else:
            table = here if isinstance(here, dict) else {}
            name = table.get("name") or table.get("field")
            out += f".{name}" if isinstance(name, str) else f"[{key + 1}]"
    return out


def _step(here: Any, key: str | int) -> Any:
    """Return what a table or a list has at a key; None if nothing."""
    if isinstance(here, dict):
        return here.get(key)
    if isinstance(here, list) and isinstance(key, int) and key < len(here):
        return here[key]
    return None


class _Location(NamedTuple):
    """Where in a file something is wrong.

    `keys` lead there, without the tags of pydantic's unions, from a table that has, or
    should have, the last of them. `kinds` are all that this table could be in a union.
    """

    keys: tuple[str | int, ...]
    table: type[BaseModel]
    kinds: tuple[type[BaseModel], ...]


def _place(schema: type[BaseModel], loc: tuple[str | int, ...]) -> _Location:
    keys, here, table = [], schema, schema
    kinds = of_table = ()
    for step in loc:
        arms = _arms(here)
        if arms:
            here, kinds = arms.get(str(step)), _tables(arms)
            continue
        here = _bare(here)
        if _is_table(here):
            table, of_table = here, kinds
        here, kinds = _inside(here, step), ()
        keys.append(step)
    return _Location(tuple(keys), table, _tables(_arms(here)) or of_table)


def _inside(annotation: Any, step: str | int) -> Any:
    """Return the annotation of a key of a table, or of the items of a collection."""
    if _is_table(annotation):
        field = annotation.model_fields.get(str(step))
        return field.annotation if field else None
    members = [a for a in get_args(annotation) if a is not str]
    return members[0] if members else None


def _bare(annotation: Any) -> Any:
    """Strip an annotation of its metadata and of None."""
    parts = [a for a in get_args(annotation) if a is not type(None)]
    if typing.get_origin(annotation) is typing.Annotated:
        return _bare(parts[0])
    if typing.get_origin(annotation) in _UNIONS and len(parts) == 1:
        return _bare(parts[0])
    return annotation


def _arms(annotation: Any) -> dict[str, Any]:
    """Return the members of a union by pydantic's tags; empty for anything else."""
    annotation = _bare(annotation)
    union = typing.get_origin(annotation) in _UNIONS
    return {_tag(a): _bare(a) for a in get_args(annotation)} if union else {}


def _tables(arms: dict[str, Any]) -> tuple[type[BaseModel], ...]:
    return tuple(arm for arm in arms.values() if _is_table(arm))


def _tag(arm: Any) -> str:
    for option in getattr(arm, "__metadata__", ()):
        if isinstance(option, Tag):
            return option.tag
    if _is_table(arm) and "type" in arm.model_fields:
        return type_of(arm)
    return getattr(arm, "__name__", str(arm))


def _is_table(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)
