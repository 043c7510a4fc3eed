"""The base of what the package is made of: records that show themselves in one line.

Units are those that the docstring of a class gives to its attributes, "[Pa]", or the
metadata of a field; values are shown in a readable one.
"""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from inspect import cleandoc
from os import PathLike
from pathlib import PurePath
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._results import RESULTS
from softcal_jax._text import escaped
from softcal_jax._typing import is_traced
from softcal_jax._units import readable_unit, readable_values

MOST = 120
"""Most characters of the line."""

_MOST_INNER = 60
"""Most characters of a record inside another; beyond, its class alone is named."""

_MOST_LISTED = 4
"""Most names or numbers that are listed; of more, the number is told too."""

_SEVERAL = "(SI)"
"""Stands for the unit of a value that may be of several kinds."""

_OUTCOME = type(RESULTS.converged)
"""The members of `RESULTS` and of other lists of outcomes."""

_UNIT = re.compile(r"\[(-|[A-Za-z][\w /^*]*)\]")


class Module(eqx.Module):
    """An immutable record of the package; `repr` writes it in one line.

    `equinox.tree_pformat` still writes all of it.
    """

    def __repr__(self) -> str:
        return one_line(self)

    def _words(self) -> str:
        """What to say of it in place of its fields; empty for the fields."""
        return ""


class Result(Module):
    """A record that notebooks show with tables and a picture."""

    def _repr_html_(self) -> str:
        # By name: what writes pages stands above what is written.
        return import_module("softcal_jax.report").notebook_html(self)


def one_line(self: Any) -> str:
    """Describe a record in one line, like "NeoHookean, E = 150 kPa, nu = 0.49".

    A text of its own comes first, of which the first line is taken; without one its
    fields are written, as many as there is room for.

    Args:
        self: A dataclass or a named tuple; its fields may hold anything, also what is
            traced, batched or missing.
    """
    kind = type(self).__name__
    words = _own_words(self)
    if not words:
        return _described(self, ", {}")
    name = getattr(self, "name", None)
    if isinstance(name, str) and name not in words:
        kind += f" {_quoted(name)}"
    return _cut(f"{kind}: {words}")


def _own_words(own: Any) -> str:
    try:
        words = own._words() if isinstance(own, Module) else ""
        if not words and type(own).__str__ not in (object.__str__, tuple.__str__):
            words = str(own)
    # Tracebacks write records that are half-built or hold tracers, too.
    except Exception:
        return ""
    return " ".join(escaped(words.partition("\n")[0]).split()).rstrip(":")


def _described(own: Any, frame: str, most: int = MOST) -> str:
    """Write the class, the name and the fields of a record.

    Args:
        own: The record.
        frame: What stands around the fields behind the class.
        most: Most characters.
    """
    values = {key: getattr(own, key) for key in _keys(own) if hasattr(own, key)}
    head = type(own).__name__
    if isinstance(values.get("name"), str):
        head += f" {_quoted(values.pop('name'))}"
    units = _units(type(own))
    common = values.pop("unit", "") if "unit" in values else ""
    texts = []
    defaults = _defaults(type(own))
    for key, value in values.items():
        if _says_nothing(value, defaults.get(key)):
            continue
        unit = units.get(key, "" if isinstance(value, int) else str(common))
        text = _written(value, "" if unit == "-" else unit)
        if text:
            texts.append(f"{key} = {text}")
    room = most - len(head) - len(frame)
    shown = _as_fit(texts, room)
    return _cut(head + (frame.format(shown) if shown else ""), most)


def _as_fit(texts: Sequence[str], room: int) -> str:
    """Join as many texts as there is room for; dots stand for the others."""
    whole = ", ".join(texts)
    if len(whole) <= room:
        return whole
    shown: list[str] = []
    for text in texts:
        if len(", ".join([*shown, text, "..."])) <= room:
            shown.append(text)
    return ", ".join([*shown, "..."])


def _keys(own: Any) -> Sequence[str]:
    if dataclasses.is_dataclass(own):
        return [field.name for field in dataclasses.fields(own)]
    if isinstance(own, tuple):
        return getattr(own, "_fields", ())
    return [key for key in vars(own) if not key.startswith("_")]


@cache
def _defaults(kind: type) -> Mapping[str, Any]:
    """Values that fields have without being given."""
    if dataclasses.is_dataclass(kind):
        return {field.name: field.default for field in dataclasses.fields(kind)}
    return getattr(kind, "_field_defaults", {})


def _says_nothing(value: Any, default: Any) -> bool:
    """Whether a field has its default, unless that is a number other than 0."""
    if isinstance(value, bool | str):
        return type(value) is type(default) and value == default
    if not isinstance(default, int | float) or default != 0 or is_traced(value):
        return False
    number = jnp.issubdtype(getattr(value, "dtype", np.float64), np.number)
    return number and np.ndim(value) == 0 and bool(value == 0)


@cache
def _units(kind: type) -> Mapping[str, str]:
    """Units of the fields of a class, by its docstrings and its fields' metadata."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        _, _, attributes = cleandoc(base.__dict__.get("__doc__") or "").partition(
            "Attributes:\n"
        )
        section = re.split(r"\n(?=\S)", attributes)[0]
        for entry in re.split(r"^ {4}(?=\w)", section, flags=re.M):
            name, _, words = entry.partition(":")
            units = {unit[1] for unit in _UNIT.finditer(words)}
            if units:
                found[name] = units.pop() if len(units) == 1 else _SEVERAL
    fields = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    return found | {
        field.name: field.metadata["unit"]
        for field in fields
        if field.metadata.get("unit")
    }


def _written(value: Any, unit: str) -> str:
    """Write the value of a field; empty for what says nothing."""
    if value is None or value is False:
        return ""
    if isinstance(value, str):
        return _quoted(value) if value else ""
    if isinstance(value, bool):
        return "yes"
    if isinstance(value, int | float | np.generic):
        return _numbers(np.asarray(value), unit)
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return _array(value, unit)
    if isinstance(value, _OUTCOME):
        return re.sub(r".*<(.*)>", r"\1", str(value))
    if _is_record(value):
        return _inner(value)
    if isinstance(value, Mapping):
        return _listed([_plain(key) for key in value])
    if isinstance(value, tuple | list | set | frozenset):
        return _several(list(value), unit)
    return _plain(value)


def _inner(own: Any) -> str:
    """Write a record inside another."""
    kind, words = type(own).__name__, _own_words(own)
    text = f"{kind}({words})" if words else _described(own, "({})", most=10 * MOST)
    return text if len(text) <= _MOST_INNER else f"{kind}(...)"


def _is_record(value: Any) -> bool:
    fields = hasattr(value, "_fields") or dataclasses.is_dataclass(value)
    return fields and not isinstance(value, type)


def _several(values: list[Any], unit: str) -> str:
    """Write the items of a sequence: their names, their numbers, or how many."""
    if not values:
        return ""
    if all(isinstance(value, str) for value in values):
        return _listed([escaped(value) for value in values])
    if all(isinstance(value, int | float) for value in values):
        return _numbers(np.asarray(values), unit)
    names = [getattr(value, "name", None) for value in values]
    if all(isinstance(name, str) for name in names):
        return _listed([escaped(str(name)) for name in names])
    if len(values) == 1:
        return _written(values[0], unit)
    if all(isinstance(value, np.ndarray | jax.Array) for value in values):
        return f"{len(values)} arrays"
    kinds = {type(value).__name__ for value in values}
    return f"{len(values)} {kinds.pop()}" if len(kinds) == 1 else f"{len(values)} items"


def _array(value: Any, unit: str) -> str:
    """Write an array: its numbers where there are few, else their range or shape."""
    if is_traced(value) or isinstance(value, jax.ShapeDtypeStruct):
        return f"traced {_shape(value.shape)}"
    if isinstance(value, jax.Array) and value.is_deleted():
        return f"deleted {_shape(value.shape)}"
    if jnp.issubdtype(value.dtype, jax.dtypes.extended):  # keys of random
        return _shape(value.shape)
    return _numbers(np.asarray(value), unit)


def _shape(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape)) or "scalar"


def _numbers(values: np.ndarray, unit: str) -> str:
    """Write numbers in a readable unit."""
    if values.size == 0:
        return ""
    if values.dtype == bool:
        return f"{int(values.sum())} of {values.size}"
    if values.dtype.kind not in "iuf" or values.ndim > 1:
        return _shape(values.shape)
    if values.dtype.kind in "iu" and values.size > _MOST_LISTED:
        return _shape(values.shape)
    if not values.any():
        return "0"  # in any unit
    flat = values.ravel().tolist()
    if values.size <= _MOST_LISTED:
        return readable_values(flat, unit, digits=5).rstrip()
    low, high = float(np.min(values)), float(np.max(values))
    if low == high:
        return f"{readable_values([low], unit).rstrip()} ({len(flat)} times)"
    factor, shown = readable_unit([low, high], unit)
    ends = f"{factor * low:.4g} to {factor * high:.4g} {shown}".rstrip()
    return f"{ends} ({len(flat)} values)"


def _listed(names: Sequence[str]) -> str:
    """List names; of many the first ones, and how many there are."""
    if len(names) <= _MOST_LISTED:
        return f"({', '.join(names)})" if len(names) > 1 else "".join(names)
    return f"({', '.join(names[: _MOST_LISTED - 1])}, ... {len(names)} in all)"


def _plain(value: Any) -> str:
    """Write what is no record: a function by its name, others by their class."""
    if isinstance(value, str):
        return escaped(value)
    if isinstance(value, PathLike):
        return _quoted(PurePath(value).name)
    if callable(value):
        return str(getattr(value, "__name__", type(value).__name__))
    return type(value).__name__


def _quoted(text: str) -> str:
    return f'"{_cut(" ".join(escaped(text).split()), _MOST_INNER)}"'


def _cut(text: str, most: int = MOST) -> str:
    return text if len(text) <= most else f"{text[: most - 3].rstrip()}..."
