"""Tables and cells for the terminal."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import rich.table

_LEFT = ("role", "actuator", "rigid body", "state", "of", "effector")


def start_table(title: str, first: str, columns: Sequence[str]) -> "rich.table.Table":
    """Start a table whose columns of numbers are aligned on the right."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold")
    table.add_column(first)
    for column in columns:
        table.add_column(column, justify="left" if column in _LEFT else "right")
    return table


def plain_text(text: str, style: str = "") -> Any:
    """Make literal text, so that a name like "[a]" is not read as markup."""
    from rich.text import Text

    return Text(text, style=style)


def add_row(table: "rich.table.Table", *cells: str | tuple[str, str]) -> None:
    """Add a row of literal texts to a table, some with a style: (text, style)."""
    pairs = [(cell,) if isinstance(cell, str) else cell for cell in cells]
    table.add_row(*(plain_text(*pair) for pair in pairs))
