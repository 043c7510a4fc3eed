"""Quantities of a project file as they were typed, and what they were read as."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from softcal_jax._module import one_line
from softcal_jax.project._problems import key_path
from softcal_jax.project._quantities import recognised
from softcal_jax.project._toml import Keys, read_toml
from softcal_jax.project._windows import WindowTable

_NAMES = ("name", "displacement_from", "recording")
"""Keys of names, which may look like quantities: a pose "350 mbar"."""

_WINDOW = WindowTable.model_fields
"""Keys of a window of time; a `select` without them names cells of a table."""


class QuantityAsRead(NamedTuple):
    """A quantity of a project file.

    Attributes:
        table: The table or list that it stands in, like "material".
        key: Its whole key, like "material.E".
        typed: Its text in the file.
        values: One number or three, in SI units.
        unit: That unit.
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

    Args:
        path: A project file that `load_project` accepts.

    Raises:
        FileNotFoundError: If there is no such file.
        ProjectError: If it is not TOML.
    """
    raw = read_toml(Path(path), "project file")
    found = []
    for keys, text in _texts((), raw):
        quantity = recognised(text)
        if quantity is not None:
            table = key_path(keys[:-1], raw)
            found.append(QuantityAsRead(table, key_path(keys, raw), text, *quantity))
    return tuple(found)


def _texts(keys: Keys, value: Any) -> Iterator[tuple[Keys, str]]:
    """Walk through tables and lists to their texts, except names."""
    if isinstance(value, dict):
        rows = bool(keys) and keys[-1] == "select" and not {*value} & {*_WINDOW}
        for key, inner in value.items():
            if key not in _NAMES and not rows:
                yield from _texts((*keys, key), inner)
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from _texts((*keys, number), inner)
    elif isinstance(value, str):
        yield keys, value
