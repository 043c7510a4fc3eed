"""The base of what the package is made of: records that show themselves in one line.

Units are those in the docstring of a class, "[Pa]" after an attribute; values are shown
in a readable one. Equinox writes what is neither text, a record nor a few numbers.
"""

import dataclasses
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from inspect import cleandoc
from typing import Any, Literal, TypeVar

import equinox as eqx
import numpy as np

from softcal_jax import _notebook
from softcal_jax._text import escaped
from softcal_jax._units import readable_values

MOST, _MOST_NUMBERS = 120, 4  # most characters of the line, and most numbers
_ATTR = re.compile(r"^    (\w+): (.*(?:\n      .*)*)", re.M)
_UNIT = re.compile(r"\[([A-Za-z][\w /^*]*)\]")


def if_any(convert: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Make a converter of a field that leaves None as it is."""
    return lambda value: None if value is None else convert(value)


Size = Literal["any", "finite", "not negative", "positive"]
"""What a quantity of a project file may be; every size but "any" is finite."""


def key(
    unit: str | None = None, words: str = "", size: Size = "finite", **more: Any
) -> dict[str, Any]:
    """Build the metadata of a field: how project files give it.

    Args:
        unit: SI unit, like "m"; "" for a plain number or a direction; None for what is
            read as its annotation says.
        words: What it is, with an example: 'its radius: "5 mm"'.
        size: What it may be; "any" where the class itself says what is allowed.
        more: Its `key`, if that is not the name of the field; whether a file must state
            it, `required`, though it has a default; `bare`, the key of an entry of a
            list that may stand there without its table.
    """
    quantity = {} if unit is None else {"unit": unit, "size": size}
    return {"words": words, **quantity, **more}


Function = TypeVar("Function", bound=Callable)


def keys(**metadata: Mapping[str, Any]) -> Callable[[Function], Function]:
    """Offer arguments of a function to project files, each with metadata of `key`."""

    def offered(function: Any) -> Any:
        function.keys = metadata
        return function

    return offered


class Module(eqx.Module):
    """An immutable record of the package; `repr` writes it in one line.

    `equinox.tree_pformat` still writes all of it.
    """

    def __repr__(self) -> str:
        # Its `_words`, else the first line of the `__str__` of its class, else its
        # fields, whose values may be anything: also traced, deleted or missing.
        head, words = type(self).__name__, _own_words(self)
        name = getattr(self, "name", None) if "name" in _defaults(type(self)) else None
        if isinstance(name, str) and name not in words:
            head += f' "{name}"'
        text = f"{head}: {words}" if words else ", ".join([head, *_fields(self)])
        return textwrap.shorten(escaped(text), MOST, placeholder="...")

    def _words(self) -> str:
        """Describe the record without its fields; an empty text shows the fields."""
        return ""


class Result(Module):
    """A record that prints itself as a report, and that notebooks show as a page."""

    def __str__(self) -> str:
        return _notebook.text_of(self)

    def _words(self) -> str:
        return _notebook.headline_of(self)

    def _repr_html_(self) -> str | None:
        return _notebook.html_of(self)


def _own_words(record: Module) -> str:
    has_text = type(record).__str__ not in (object.__str__, Result.__str__)
    try:
        words = record._words() or (str(record) if has_text else "")
    # Tracebacks write records that are half-built or hold tracers, too.
    except Exception:
        return ""
    return words.partition("\n")[0].rstrip(":")


@cache
def _defaults(kind: type) -> Mapping[str, Any]:
    """Return the fields of a class, with the values that they have by default."""
    return {field.name: field.default for field in dataclasses.fields(kind)}


def _fields(record: Any) -> Iterator[str]:
    """Write fields, like "E = 150 kPa"; of those at their default, only numbers."""
    units, common = _units(type(record)), getattr(record, "unit", "")
    for key, default in _defaults(type(record)).items():
        value = getattr(record, key, None)
        usual = value is default and type(value) not in (int, float)
        if key not in ("name", "unit") and value is not None and not usual:
            unit = units.get(key, "" if isinstance(value, int) else common)
            yield f"{key} = {_written(value, str(unit))}"


@cache
def _units(kind: type) -> Mapping[str, str]:
    """Find the units of the fields of a class in its docstrings."""
    texts = "\n\n".join(cleandoc(c.__doc__ or "") for c in reversed(kind.__mro__))
    by_field = {name: set(_UNIT.findall(words)) for name, words in _ATTR.findall(texts)}
    return {name: units.pop() for name, units in by_field.items() if len(units) == 1}


def _written(value: Any, unit: str) -> str:
    """Write the value of a field: a text, numbers, a record, or as equinox does."""
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, Module):
        return f"{type(value).__name__}({', '.join(_fields(value))})"
    if getattr(value, "size", 0) <= _MOST_NUMBERS:
        try:
            numbers = np.asarray(value)
        except Exception:  # traced, deleted, ragged, or of another package
            numbers = np.empty(0, object)
        few = 0 < numbers.size <= _MOST_NUMBERS and numbers.ndim < 2
        if few and numbers.dtype.kind in "iuf":
            return readable_values(numbers.ravel().tolist(), unit, digits=5).rstrip()
    return eqx.tree_pformat(value, width=sys.maxsize)
