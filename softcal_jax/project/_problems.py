"""What is wrong with a project file, in words: the key, what it needs, a near one."""

import contextlib
import re
import typing
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from softcal_jax import _names

# The parts of a union are told apart by these tags, which are no keys of the file.
_TAGS = ("(table)", "(vector)")

_EXPECTED = {
    "string_type": "a text in quotes",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "tuple_type": "a list in [ ]",
    "dict_type": "a table",
    "model_type": "a table",
}


class ProjectError(ValueError):
    """Something in a project file is wrong; nothing was solved or written."""


def one_by_one(path: Path, problems: Iterable[str]) -> ProjectError:
    """The error that lists problems of a file, one per line."""
    problems = list(dict.fromkeys(problems))
    if len(problems) == 1:
        return ProjectError(f"{path}: {problems[0]}")
    listed = "".join(f"\n- {problem}" for problem in problems)
    return ProjectError(f"{path}: {len(problems)} problems.{listed}")


@contextlib.contextmanager
def at(path: Path, key: str) -> Iterator[None]:
    """Puts file and key in front of what goes wrong inside."""
    try:
        yield
    except ProjectError:
        raise
    except (ValueError, OSError, ImportError) as error:
        raise ProjectError(f"{path}: {key}: {error}") from error


def describe(
    error: ValidationError, schema: type[BaseModel], raw: dict[str, Any]
) -> list[str]:
    """One message for each thing that pydantic found.

    Args:
        error: What pydantic raised.
        schema: Model of the whole file.
        raw: The file as it was read, with [shared] still apart.

    Returns:
        Messages that start with the path of a key.
    """
    return [_message(details, schema, raw) for details in error.errors()]


def _message(
    details: ErrorDetails, schema: type[BaseModel], raw: dict[str, Any]
) -> str:
    keys = tuple(key for key in details["loc"] if key not in _TAGS)
    where, kind = _path(keys, raw), details["type"]
    if kind == "extra_forbidden":
        known = list(_model_at(schema, keys[:-1]).model_fields)
        if len(keys) == 1 and "configurations" in known:
            known.append("shared")
        return (
            f"{where}: unknown key.{suggestion(str(keys[-1]), known)} "
            f"Known here: {', '.join(known)}."
        )
    if kind == "missing" and isinstance(keys[-1], int):
        return f"{where}: missing; the list is too short."
    if kind == "missing":
        model, key = _model_at(schema, keys[:-1]), str(keys[-1])
        field = model.model_fields.get(key)
        what = f" Expected {field.description}." if field and field.description else ""
        return f"{where}: missing.{what}"
    return f"{where or 'file'}: {_wrong_value(details)}"


def _wrong_value(details: ErrorDetails) -> str:
    kind, value, context = details["type"], details["input"], details.get("ctx", {})
    if kind in ("quantity", "value_error"):
        return str(context.get("problem") or context.get("error"))
    got = f"got {shown(value)}; expected "
    if kind == "literal_error":
        # pydantic writes them as 'a', 'b' or 'c'.
        choices = re.findall("'([^']*)'", context["expected"])
        listed = ", ".join(f'"{choice}"' for choice in choices)
        return f"{got}one of {listed}.{suggestion(str(value), choices)}"
    if kind == "too_long":
        return f"expected {context['max_length']} values, got {len(value)}."
    if kind in _EXPECTED:
        return f"{got}{_EXPECTED[kind]}."
    return f"{got}{details['msg'].removeprefix('Input should be ')}."


def shown(value: Any) -> str:
    """A value as a project file writes it."""
    return f'"{value}"' if isinstance(value, str) else str(value)


def suggestion(name: str, known: Iterable[str]) -> str:
    """The near one in a sentence, quoted as project files quote."""
    return _names.suggestion(name, known, quote='"')


def known_name(kind: str, name: str, known: Iterable[str], section: str) -> None:
    """Checks that a table of the file has a name.

    Args:
        kind: What it is, for messages.
        name: The name.
        known: Names that are there.
        section: Table of the file that has them.

    Raises:
        ValueError: If it is not among them.
    """
    known = list(known)
    if name in known:
        return
    if not known:
        raise ValueError(
            f'there is no {kind} "{name}"; the project has none: add a table '
            f"[{section}.{name}]."
        )
    raise ValueError(
        f'there is no {kind} "{name}".{suggestion(name, known)} '
        f"Known: {', '.join(known)}."
    )


def _path(keys: tuple[str | int, ...], raw: dict[str, Any]) -> str:
    """Dotted path; an entry of a list is called by its name, or counted from 1."""
    posed = keys[:1] in (("configurations",), ("candidates",))
    if posed and len(keys) > 2 and not _has(raw, keys):
        if _has(raw, ("shared", *keys[2:])):
            keys = ("shared", *keys[2:])
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
    if isinstance(here, dict):
        return here.get(key)
    if isinstance(here, list) and isinstance(key, int) and key < len(here):
        return here[key]
    return None


def _has(raw: Any, keys: tuple[str | int, ...]) -> bool:
    for key in keys:
        raw = _step(raw, key)
    return raw is not None


def _model_at(schema: type[BaseModel], keys: tuple[str | int, ...]) -> type[BaseModel]:
    """The model of the table that a path of keys leads to."""
    here: Any = schema
    for key in keys:
        if isinstance(here, type) and issubclass(here, BaseModel):
            here = here.model_fields[str(key)].annotation
        else:
            # Into a list by number or into a table of tables by name: its members.
            here = next(a for a in get_args(here) if a is not str)
        here = _plain(here)
    return here


def _plain(annotation: Any) -> Any:
    """An annotation without its options: of a union, the part that is a table."""
    while typing.get_origin(annotation) not in (None, dict, tuple, list):
        parts = [a for a in get_args(annotation) if a is not type(None)]
        if typing.get_origin(annotation) is typing.Annotated:
            annotation = parts[0]
            continue
        tables = [a for a in parts if _is_table(a)]
        annotation = (tables or parts)[0]
    return annotation


def _is_table(annotation: Any) -> bool:
    if typing.get_origin(annotation) is typing.Annotated:
        return _is_table(get_args(annotation)[0])
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)
