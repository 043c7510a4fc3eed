"""What a result says, as a tree: sections with texts, tables and charts.

Numbers are in SI. Whoever writes the tree, for a terminal, a page or a file, chooses
units and digits by `Column.texts`.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from softcal_jax._typing import HostArray
from softcal_jax._units import (
    readable_estimate,
    readable_unit,
    readable_values,
)

Tone = Literal["plain", "strong", "good", "doubtful", "bad"]
"""How a text is meant; its words must say so too, as colours are not seen by all."""

MOST_REASONS = 3  # reasons of a verdict that stand in the first screen


class Value(NamedTuple):
    """A value of a table of which more is to be said than by its column.

    Attributes:
        value: A number in SI, a vector of a few, or words; nan and None are missing.
        unit: What it is, see `Column`, if that differs from row to row.
        error: Its standard error, in SI; nan where none may be shown.
        note: What stands behind it, like "(imposed)".
        tone: How it is meant.
        digits: Significant digits in an SI unit, if not those of its column.
    """

    value: Any
    unit: str | None = None
    error: float | None = None
    note: str = ""
    tone: Tone = "plain"
    digits: int | None = None


class Column(NamedTuple):
    """A column of a table.

    Attributes:
        title: Its head.
        content: A `Value` for each row, or what it would hold alone.
        quantity: What the values are: a name in `QUANTITIES`, or an SI unit.
        digits: Significant digits of values in an SI unit.
    """

    title: str
    content: Sequence[Any] | HostArray
    quantity: str = ""
    digits: int = 4

    @property
    def cells(self) -> list[Value]:
        """Its cells."""
        return [c if isinstance(c, Value) else Value(c) for c in self.content]

    @property
    def values(self) -> list[Any]:
        """Its values: numbers in SI, vectors of a few, or words."""
        return [cell.value for cell in self.cells]

    @property
    def holds_words(self) -> bool:
        """Whether it holds words, which are aligned on the left."""
        return all(isinstance(value, str) for value in self.values)

    @property
    def unit(self) -> str:
        """The unit in which all its values are written; empty where they differ."""
        if self.holds_words or any(cell.unit is not None for cell in self.cells):
            return ""
        text = readable_values([0.0], self.quantity, beside=self._numbers())
        return text.partition(" ")[2]

    def _numbers(self) -> list[float]:
        known = (v for v in self.values if v is not None and not isinstance(v, str))
        return np.concatenate([np.zeros(0), *map(np.ravel, known)]).tolist()

    def texts(self, *, units: bool = True) -> list[str]:
        """Write its values, those of one quantity in a common unit; a dash is no value.

        Without `units`, the unit is not written.
        """
        numbers, texts, unit = self._numbers(), [], "" if units else self.unit
        for value, own, error, note, _, digits in self.cells:
            quantity, beside = (self.quantity, numbers) if own is None else (own, [])
            if value is None or isinstance(value, str):
                text = value or "-" * (value is None)
            elif error is not None:
                factor, shown = readable_unit(beside or [value], quantity)
                text = readable_estimate(factor * value, factor * error, "")
                text += f" {shown}"
            else:
                about = {"digits": digits or self.digits, "beside": beside}
                text = readable_values(np.ravel(value).tolist(), quantity, **about)
                text = text.replace("unknown", "-")
            text = text.rstrip() if units else text.removesuffix(f" {unit}")
            texts.append(f"{text} {note}".rstrip())
        return texts


class Table(NamedTuple):
    """A table; the first column names what a row is about, and a note stands below."""

    title: str
    columns: tuple[Column, ...]
    note: str = ""

    @classmethod
    def of(
        cls,
        title: str,
        heads: str,
        rows: Iterable[Sequence[Any]],
        *,
        note: str = "",
        digits: int = 4,
    ) -> "Table":
        """Make a table of rows.

        Args:
            title: Its title.
            heads: Those of its columns, like "pose | area [m2]", with quantities.
            rows: What stands in each column: a `Value`, or what it would hold alone.
            note: What stands below.
            digits: Significant digits of values in an SI unit.
        """
        found = [re.fullmatch(r"(.*?) ?(?:\[(.+)\])?", h) for h in heads.split(" | ")]
        parts = [match.groups("") for match in found if match is not None]
        every = [*zip(*rows, strict=True)] or [()] * len(parts)
        columns = (
            Column(head, cells, quantity, digits)
            for (head, quantity), cells in zip(parts, every, strict=True)
        )
        return cls(title, tuple(columns), note)

    def rows(self) -> list[tuple[str, ...]]:
        """Write the texts of its rows."""
        return [*zip(*(column.texts() for column in self.columns), strict=True)]

    def __bool__(self) -> bool:
        """Whether it has rows."""
        return bool(self.columns) and len(self.columns[0].content) > 0


class Chart(NamedTuple):
    """A chart; `plot` writes it to a path, in a `style` of `plotting`."""

    title: str
    plot: Callable[..., Any]
    caption: str


class Section(NamedTuple):
    """A part of what a result says, under a heading.

    Attributes:
        key: Its name for programs, and for links.
        title: Its heading; those without one stand above all others.
        text: Sentences; those after one that ends with a colon are its list.
        tables: Tables.
        charts: Charts; a terminal shows none.
        tone: How the first sentence is meant.
        folded: Whether it is for the curious: a page folds it, a terminal omits it.
    """

    key: str
    title: str
    text: Sequence[str] = ()
    tables: Sequence[Table] = ()
    charts: Sequence[Chart] = ()
    tone: Tone = "plain"
    folded: bool = False

    def __bool__(self) -> bool:
        """Whether it says anything."""
        return bool(self.text or self.charts) or any(self.tables)


def verdict(sentence: str, tone: Tone, reasons: Iterable[str] = ()) -> Section:
    """Begin a result with a sentence on it, and what there is to doubt."""
    return Section("verdict", "", (sentence, *reasons), tone=tone)


def listed_texts(text: Sequence[str]) -> list[tuple[str, bool]]:
    """Return sentences, and whether each is an item of a list."""
    ends = [k for k, sentence in enumerate(text) if sentence.endswith(":")]
    first = ends[0] if ends else len(text)
    return [(sentence, k > first) for k, sentence in enumerate(text)]
