"""TOML files as Python has them, without control characters."""

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from softcal_jax._files import check_file
from softcal_jax._text import check_characters, escaped
from softcal_jax.project._problems import ProjectError, key_path, one_by_one

Keys = tuple[str | int, ...]


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Read a TOML file, and check that none of its texts would act on a terminal.

    Messages say `what` it is, like "project file".

    Raises:
        FileNotFoundError: If there is no such file.
        ProjectError: If it is too large, no TOML, or has control characters.
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
    for keys, text in texts_in(raw):
        try:
            check_characters("".join(map(str, (*keys, text))))
        except ValueError as error:
            problems.append(f"{escaped(key_path(keys, raw)) or 'file'}: {error}")
    if problems:
        raise one_by_one(path, problems)
    return raw


def texts_in(value: Any, keys: Keys = ()) -> Iterator[tuple[Keys, str]]:
    """Find all texts in tables and lists, with the keys that lead to them."""
    if isinstance(value, str):
        yield keys, value
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from texts_in(inner, (*keys, key))
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from texts_in(inner, (*keys, i))
