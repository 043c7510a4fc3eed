"""Results as tables and sentences, which a terminal and a page show alike."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from softcal_jax.identifiability import Tone

_WORDS = {"role", "effector", "actuator", "rigid body", "state", "of", "file"}
_WORDS |= {"outcome", "verdict", "standard error over the value", "kind", "SHA-256"}
_WORDS |= {"begun from"}
"""Columns of words; the others hold numbers."""


class Cell(NamedTuple):
    """A cell of a table.

    Attributes:
        text: What it shows.
        tone: How it is meant.
    """

    text: str
    tone: Tone = "plain"


class Table(NamedTuple):
    """A table of results.

    Attributes:
        title: Its title.
        columns: Heads of the columns; the first names what a row is about.
        rows: The cells, one row per thing.
        words: Names of columns of words, besides those that hold words everywhere.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    words: tuple[str, ...] = ()

    def holds_words(self, column: int) -> bool:
        """Whether a column holds words, which are aligned on the left."""
        return column == 0 or self.columns[column] in {*_WORDS, *self.words}


def described(
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str | Cell]],
    *,
    words: Sequence[str] = (),
) -> Table:
    """Make a table of texts and cells; `words` are columns of words."""
    cells = (
        tuple(Cell(own) if isinstance(own, str) else own for own in row) for row in rows
    )
    return Table(title, tuple(columns), tuple(cells), tuple(words))
