"""The tree of a result as Markdown."""

from collections.abc import Sequence

from softcal_jax._tree import Section, Table, listed_texts


def markdown(tree: Sequence[Section]) -> str:
    """Write a tree as Markdown, with tables as GitHub reads them."""
    lines = []
    for section in tree:
        lines += [f"## {section.title}"] * bool(section.title)
        lines += [f"- {t}" if item else t for t, item in listed_texts(section.text)]
        for table in filter(None, section.tables):
            lines += _table(table)
    return "\n\n".join(lines)


def _table(table: Table) -> list[str]:
    rows = [tuple(column.title for column in table.columns), *table.rows()]
    cells = [f"| {' | '.join(row)} |" for row in rows]
    cells.insert(1, "|---" * len(table.columns) + "|")
    return [f"**{table.title}**"] * bool(table.title) + ["\n".join(cells)]
