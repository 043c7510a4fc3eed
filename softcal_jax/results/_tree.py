"""What a result says, as a tree: sections with texts, tables and charts; and as text.

Numbers are in SI. Whoever writes the tree, for a terminal, a page or a file, chooses
units and digits by `Column.texts`.
"""

import io
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from rich.box import HEAVY_HEAD, Box
from rich.console import Console, Group
from rich.table import Table as Drawn
from rich.text import Text

from softcal_jax._files import write_rows
from softcal_jax._text import escaped
from softcal_jax._typing import HostArray
from softcal_jax._units import (
    QUANTITIES,
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


STYLES: dict[Tone, str] = {
    "plain": "",
    "strong": "bold",
    "good": "green",
    "doubtful": "yellow",
    "bad": "bold red",
}
"""Styles of the tones in a terminal."""


def console(tree: Sequence[Section], *, short: bool = False) -> Group:
    """Write a tree for a terminal; what is first on a page is last there, to be seen.

    A `short` one has only that, and few reasons of the verdict.
    """
    head = [section for section in tree if not section.title]
    rest = [] if short else [section for section in tree if section.title]
    most = MOST_REASONS if short else None
    return Group(*(p for s in (*rest, *head) for p in _parts(s, HEAVY_HEAD, most)))


def text(tree: Sequence[Section]) -> str:
    """Write a tree as text, the columns of tables aligned, in the order of reading."""
    file, plain = io.StringIO(), {"color_system": None, "highlight": False}
    # In a notebook, rich would show each part by itself.
    console = Console(file=file, width=10_000, force_jupyter=False, **plain)
    for section in tree:
        for part in _parts(section, None, None):
            console.print(part)
    lines = (line.rstrip() for line in escaped(file.getvalue()).splitlines())
    return "\n".join(lines)


def _parts(section: Section, box: Box | None, most: int | None) -> Iterator[Any]:
    """Yield texts and tables of a section, but for what is folded."""
    if section.folded or not section:
        return
    texts, style = section.text, STYLES[section.tone]
    if most is not None and section.key == "verdict" and len(texts) > most + 1:
        texts = *texts[: most + 1], f"and {len(texts) - most - 1} more."
    repeated = any(table.title == section.title for table in section.tables)
    if section.title and texts and not repeated:
        yield Text(section.title, style="bold")
    for k, (sentence, is_item) in enumerate(listed_texts(texts)):
        indent = "  " * (is_item or (section.key == "verdict" and k > 0))
        yield Text(f"{indent}{sentence}", style="" if k else style)
    for table in filter(None, section.tables):
        if table.title:
            yield _drawn(table, box)
        else:
            for name, value, more in table.rows():
                yield Text(f"{name} = {value}{f' ({more})' * bool(more)}")
        if table.note:
            yield Text(table.note)


def _drawn(table: Table, box: Box | None) -> Drawn:
    """Draw a table; its title stands above it where it has a frame."""
    title = Text(table.title, style="bold")
    drawn = Drawn(
        title=title,
        title_justify="left",
        title_style="",
        box=box,
        min_width=len(table.title),
        show_header=any(column.title for column in table.columns),
    )
    for k, column in enumerate(table.columns):
        # Text, not str, which would read a name like "[a]" as markup.
        justify = "left" if k == 0 or column.holds_words else "right"
        drawn.add_column(Text(column.title), justify=justify)
    cells = zip(*(column.cells for column in table.columns), strict=True)
    for row, of in zip(table.rows(), cells, strict=True):
        drawn.add_row(*map(Text, row, (STYLES[cell.tone] for cell in of)))
    return drawn


def write_csv(path: Path, table: Table) -> None:
    """Write a table as CSV, in SI, but `QUANTITIES` in their unit: distances in mm."""
    heads, columns = [], []
    for column in table.columns:
        unit, factor, _ = QUANTITIES.get(column.quantity, ("", 1.0, ""))
        heads.append(f"{column.title}_{unit}" if unit else column.title)
        form = ".6f" if unit else ".9g"
        columns.append([_cell(value, factor, form) for value in column.values])
    write_rows(path, heads, zip(*columns, strict=True))


def _cell(value: Any, factor: float, form: str) -> str:
    if isinstance(value, str):
        return value
    if value is None or not math.isfinite(value):
        return ""
    return f"{factor * value:{form}}"


_SPECIAL = {c: rf"\{c}" for c in "&%$#_{}"} | {"±": r"$\pm$", "^": r"\^{}"}
_SPECIAL |= {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}"}


def latex(table: Table) -> str:
    """Write a table for LaTeX, with units in the heads of columns that have one."""
    escape = lambda text: re.sub(r"[\\&%$#_{}~^±]", lambda c: _SPECIAL[c[0]], text)
    heads = [f"{c.title}{f' [{c.unit}]' * bool(c.unit)}" for c in table.columns]
    columns = [column.texts(units=not column.unit) for column in table.columns]
    rows = [heads, *zip(*columns, strict=True)]
    lines = [" & ".join(map(escape, row)) + r" \\" for row in rows]
    shape = "".join("l" if c.holds_words else "r" for c in table.columns)
    lines.insert(1, r"\hline")
    return "\n".join([rf"\begin{{tabular}}{{{shape}}}", *lines, r"\end{tabular}"])
