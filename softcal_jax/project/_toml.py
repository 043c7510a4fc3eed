"""TOML files as Python has them, with what no file of ours needs refused."""

import datetime
import tomllib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from softcal_jax._files import check_file
from softcal_jax._text import check_characters, escaped
from softcal_jax.project._problems import (
    MOST_PROBLEMS,
    ProjectError,
    key_path,
    one_by_one,
)

_DEPTH = 30
"""Lists and tables in one another, far above what any key needs."""

_LONGEST_LINE = 20_000
"""Characters of a line; the time for a dotted key grows with their square."""

_LARGEST = 2**63 - 1
"""Largest whole number that a TOML file may hold by its standard."""

Keys = tuple[str | int, ...]


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Read a TOML file, unchecked but for what no key takes, wherever it stands.

    Args:
        path: The file.
        what: What it is, for messages: "project file".

    Raises:
        FileNotFoundError: If there is no such file.
        ProjectError: If it is no file of a disk or too large, is not TOML, or has
            dates, control characters, endless nesting, endless lines or whole numbers
            above 64 bits.
    """
    try:
        check_file(path, what)
    except ValueError as error:
        raise ProjectError(str(error)) from error
    try:
        text = path.read_text(encoding="utf-8")
        _check_lines(path, text)
        raw = tomllib.loads(text)
    except ProjectError:
        raise
    except (ValueError, OSError) as error:  # of TOML, of UTF-8, or of long numbers
        raise ProjectError(f"{path} cannot be read as TOML: {error}.") from error
    except RecursionError as error:
        raise ProjectError(
            f"{path} cannot be read as TOML: its lists or tables stand in one another "
            f"without end; no key needs more than {_DEPTH} levels."
        ) from error
    problems = [
        f"{escaped(key_path(keys, raw)) or 'file'}: {problem}"
        for keys, problem in islice(_strange(raw), MOST_PROBLEMS + 1)
    ]
    if problems:
        raise one_by_one(path, problems)
    return raw


def _check_lines(path: Path, text: str) -> None:
    """Raise for a line in which tomllib could spend gigabytes on a key of many dots."""
    for number, line in enumerate(text.splitlines(), start=1):
        if len(line) > _LONGEST_LINE:
            raise ProjectError(
                f"{path}, line {number}: it has {len(line)} characters; break it, so "
                f"that none has more than {_LONGEST_LINE}."
            )


def _strange(raw: dict[str, Any]) -> Iterator[tuple[Keys, str]]:
    """Find values that no key takes; without recursion, which deep files would end."""
    waiting: list[tuple[Keys, Any]] = [((), raw)]
    while waiting:
        keys, value = waiting.pop()
        if len(keys) > _DEPTH:
            yield keys[:3], f"nested more than {_DEPTH} levels deep; write it flat."
        elif isinstance(value, dict):
            for key, inner in value.items():
                yield from _hidden(keys, key)
                waiting.append(((*keys, key), inner))
        elif isinstance(value, list):
            waiting += [((*keys, i), inner) for i, inner in enumerate(value)]
        elif isinstance(value, str):
            yield from _hidden(keys, value)
        elif isinstance(value, datetime.date | datetime.time):
            kind = "time" if isinstance(value, datetime.time) else "date"
            yield (
                keys,
                f"got the {kind} {value}, which no key takes; put a text in quotes.",
            )
        elif isinstance(value, int) and abs(value) > _LARGEST:
            yield keys, f"a whole number of {value.bit_length()} bits is too large."


def _hidden(keys: Keys, text: str) -> Iterator[tuple[Keys, str]]:
    try:
        check_characters(text)
    except ValueError as error:
        yield keys, str(error)
