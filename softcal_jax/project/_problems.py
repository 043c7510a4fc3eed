"""Errors of a project file in words: the key, what it needs, the closest match."""

import contextlib
import functools
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from softcal_jax import _names
from softcal_jax._text import shortened, with_short_names
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
    return _names.suggestion(name, known, quote='"')


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
