"""The tree of a result as text: for a terminal, as CSV, and for LaTeX."""

import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import HEAVY_HEAD, Box
from rich.console import Console, Group
from rich.table import Table as Drawn
from rich.text import Text

from softcal_jax._files import write_rows
from softcal_jax._text import escaped
from softcal_jax._units import QUANTITIES
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.results._tree import MOST_REASONS, Section, Table, Tone, listed_texts

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


_VALUES = ("measured", "simulated_before", "simulated", "residual")
_BODY = {"position": "m", "translation": "m", "rotation_vector": "rad"}
_CONTACT = {"force": "N", "moment": "N m", "area": "m2", "depth": "m", "sliding": "-"}
"""Attributes of bodies and of contacts that are written, and their units."""

_SPECIAL = {c: rf"\{c}" for c in "&%$#_{}"} | {"±": r"$\pm$", "^": r"\^{}"}
_SPECIAL |= {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}"}


def write_csv(folder: Path, configurations: Sequence[ConfigurationResult]) -> list[str]:
    """Write the values of all configurations; return the names of the files.

    A line of `markers.csv` is a marker or other point, in mm; one of `effectors.csv` a
    coordinate of an effector that is not a point, in SI; one of `robot.csv` a value of
    a body, actuator, reaction or contact, in SI. A file without lines is left out.
    """
    values = lambda e: [getattr(e, column) for column in _VALUES]
    points = [
        (c.name, c.role, p.name, *np.concatenate(values(p)), p.distance(p.simulated))
        for c in configurations
        for p in c.points
    ]
    others = [
        (c.name, c.role, e.name, name, e.unit, *coordinate)
        for c in configurations
        for e in c.others
        for name, *coordinate in zip(
            _coordinates("turn" if e.is_turn else "value", len(e.measured)),
            *values(e),
            strict=True,
        )
    ]
    state = [(c.name, *line) for c in configurations for line in _robot(c)]
    places = " | ".join(f"{v}_{axis} [distance]" for v in _VALUES for axis in "xyz")
    heads = f"configuration | role | marker | {places} | distance [distance]"
    rest = f"effector | coordinate | unit | {' | '.join(_VALUES)}"
    robot = "configuration | part | name | what | quantity | value | unit"
    tables = {
        "markers.csv": Table.of("", heads, points),
        "effectors.csv": Table.of("", f"configuration | role | {rest}", others),
        "robot.csv": Table.of("", robot, state),
    }
    written = {name: table for name, table in tables.items() if table}
    for name, table in written.items():
        _write_table(folder / name, table)
    return [*written]


def _coordinates(what: str, n: int) -> list[str]:
    return [f"{what}_{axis}" for axis in "xyz"[:n]] if n > 1 else [what]


def _robot(result: ConfigurationResult) -> Iterator[tuple[Any, ...]]:
    """Yield part, name, what it is, quantity, value and unit."""
    robot = result.robot
    if robot is None:
        return
    for body in robot.bodies:
        yield from _components("rigid body", body, body.state, _BODY)
    for a in robot.actuators:
        for what in ("force", "displacement"):
            value, unit = getattr(a, what), getattr(a, f"{what}_unit")
            if value is not None:
                quantity = f"{what}{' (imposed)' * (a.imposed == what)}"
                yield "actuator", a.name, a.kind, quantity, value, unit
    for reaction in robot.reactions:
        what = "force of the ground"
        yield from _components("reaction", reaction, what, {"force": "N"})
    bodies = {body.name for body in robot.bodies}
    for contact in robot.contacts:
        what = "obstacle" if contact.name in bodies else "pair of surfaces"
        yield from _components("contact", contact, what, _CONTACT)


def _components(
    part: str, of: Any, what: str, units: Mapping[str, str]
) -> Iterator[tuple[Any, ...]]:
    for key, unit in units.items():
        values = np.atleast_1d(getattr(of, key))
        for name, value in zip(_coordinates(key, len(values)), values, strict=True):
            yield part, of.name, what, name, value, unit


def _write_table(path: Path, table: Table) -> None:
    """Write a table as CSV, in SI, but distances in mm."""
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
