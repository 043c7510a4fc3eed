"""TOML files as Python has them, without dates and control characters."""

import datetime
import os
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from softcal_jax._files import check_file
from softcal_jax._module import one_line
from softcal_jax._text import check_characters, escaped
from softcal_jax.project._markers import WindowTable
from softcal_jax.project._problems import ProjectError, key_path, one_by_one
from softcal_jax.project._quantities import recognised

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
        values = [*values_in(raw)]
    except (ValueError, OSError, RecursionError) as error:  # of TOML, or of UTF-8
        raise ProjectError(f"{path} cannot be read as TOML: {error}.") from error
    problems = []
    for keys, value in values:
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


_NAMES = ("name", "displacement_from", "recording")
"""Keys of names, which may look like quantities: a pose "350 mbar"."""


class QuantityAsRead(NamedTuple):
    """A quantity of a project file: in "material", "material.E" is one, as typed.

    Its values are one number or three in its SI unit.
    """

    table: str
    key: str
    typed: str
    values: tuple[float, ...]
    unit: str

    __repr__ = one_line

    @property
    def read(self) -> str:
        """What it was read as, in SI; lengths in mm."""
        factor, unit = (1e3, "mm") if self.unit == "m" else (1.0, self.unit)
        numbers = [f"{factor * value:.10g}" for value in self.values]
        listed = numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"
        return f"{listed} {unit}"


def quantities_as_read(path: str | os.PathLike[str]) -> tuple[QuantityAsRead, ...]:
    """List every text with a unit in a project file, in the order of the file.

    Raises:
        FileNotFoundError: If there is no such file.
        ProjectError: If it is not TOML.
    """
    raw = read_toml(Path(path), "project file")
    found = []
    for keys, text in values_in(raw):
        rows = "select" in keys and not {*keys} & {*WindowTable.model_fields}
        quantity = recognised(text) if isinstance(text, str) else None
        if quantity is not None and not rows and not {*keys} & {*_NAMES}:
            table = key_path(keys[:-1], raw)
            found.append(QuantityAsRead(table, key_path(keys, raw), text, *quantity))
    return tuple(found)
