"""Tables of texts: as lines, for a terminal, and for a page."""

import math
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

from rich.table import Table
from rich.text import Text

Tone = Literal["plain", "strong", "good", "doubtful", "bad"]
"""How a text is meant; its words must say so too, as colours are not seen by all."""

STYLES: dict[Tone, str] = {
    "plain": "",
    "strong": "bold",
    "good": "green",
    "doubtful": "yellow",
    "bad": "bold red",
}
"""Styles of the tones in a terminal."""

_WORDS = {"role", "effector", "actuator", "rigid body", "state", "of", "file"}
_WORDS |= {"outcome", "verdict", "standard error over the value", "kind", "SHA-256"}
_WORDS |= {"begun from", "which"}
"""Columns of words; the others hold numbers."""


class Cell(NamedTuple):
    """A cell of a table: what it shows, and how that is meant."""

    text: str
    tone: Tone = "plain"


class TextTable(NamedTuple):
    """A table of texts, see `text_table`; the first column names what a row is about.

    Columns in `words` hold words, besides those that do so everywhere.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    words: tuple[str, ...] = ()

    def holds_words(self, column: int) -> bool:
        """Whether a column holds words, which are aligned on the left."""
        return column == 0 or self.columns[column] in {*_WORDS, *self.words}

    def lines(self) -> list[str]:
        """Write it as lines without its title, columns aligned on the left."""
        rows = [[cell.text for cell in row] for row in self.rows]
        return aligned([self.columns, *rows])

    def drawn(self) -> Table:
        """Draw it for a terminal."""
        title = self.title or None
        drawn = Table(title=title, title_justify="left", title_style="bold")
        for k, column in enumerate(self.columns):
            # Text, not str, which would read a name like "[a]" as markup.
            justify = "left" if self.holds_words(k) else "right"
            drawn.add_column(Text(column), justify=justify)
        for row in self.rows:
            drawn.add_row(*(Text(cell.text, style=STYLES[cell.tone]) for cell in row))
        return drawn


def text_table(
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str | Cell]],
    *,
    words: Sequence[str] = (),
) -> TextTable:
    """Make a table of texts and cells; `words` are columns of words."""
    cells = (
        tuple(Cell(cell) if isinstance(cell, str) else cell for cell in row)
        for row in rows
    )
    return TextTable(title, tuple(columns), tuple(cells), tuple(words))


def or_dash(value: float, form: str, unit: str = "") -> str:
    """Write a number, as a dash where there is none."""
    return "-" if math.isnan(value) else f"{value:{form}} {unit}".rstrip()


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Write rows of texts as lines, indented, columns aligned on the left.

    A column without a text takes no room.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = zip(row, widths, strict=True)
        line = "  ".join(cell.ljust(width) for cell, width in cells if width)
        lines.append(f"  {line.rstrip()}")
    return lines
