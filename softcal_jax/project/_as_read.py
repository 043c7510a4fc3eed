"""Quantities of a project file as they were typed, and what they were read as."""

import os
from pathlib import Path
from typing import NamedTuple

from softcal_jax._module import one_line
from softcal_jax.project._problems import key_path
from softcal_jax.project._quantities import recognised
from softcal_jax.project._toml import read_toml, values_in
from softcal_jax.project._windows import WindowTable

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
