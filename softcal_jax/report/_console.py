"""The tree of a result for a terminal, and as text without colours."""

import io
from collections.abc import Iterator, Sequence
from typing import Any

from rich.box import HEAVY_HEAD, Box
from rich.console import Console, Group
from rich.table import Table as Drawn
from rich.text import Text

from softcal_jax._text import escaped
from softcal_jax._tree import MOST_REASONS, Section, Table, Tone, listed_texts

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
