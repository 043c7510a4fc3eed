"""TOML files as Python has them, without dates and control characters."""

import datetime
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from softcal_jax._files import check_file
from softcal_jax._text import check_characters, escaped
from softcal_jax.project._problems import ProjectError, key_path, one_by_one

Keys = tuple[str | int, ...]


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Read a TOML file without dates and texts that would act on a terminal.

    Messages say `what` it is, like "project file".

    Raises:
        FileNotFoundError: If there is no such file.
        ProjectError: If it is too large, no TOML, or has dates or control characters.
    """
    try:
        check_file(path, what)
    except ValueError as error:
        raise ProjectError(str(error)) from error
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:  # of TOML, or of UTF-8
        raise ProjectError(f"{path} cannot be read as TOML: {error}.") from error
    problems = []
    for keys, value in values_in(raw):
        try:
            if isinstance(value, datetime.date | datetime.time):
                raise ValueError(f"got {value}, which no key takes; put it in quotes.")
            check_characters("".join(map(str, (*keys, value))))
        except ValueError as error:
            problems.append(f"{escaped(key_path(keys, raw)) or 'file'}: {error}")
    if problems:
        raise one_by_one(path, problems)
    return raw


def values_in(value: Any, keys: Keys = ()) -> Iterator[tuple[Keys, Any]]:
    """Find all values in tables and lists, with the keys that lead to them."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from values_in(inner, (*keys, key))
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from values_in(inner, (*keys, i))
    else:
        yield keys, value
