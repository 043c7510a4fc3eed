"""Tables as files: CSV for a spreadsheet, and LaTeX."""

import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax._text import as_cell
from softcal_jax._tree import Table
from softcal_jax._units import QUANTITIES
from softcal_jax.calibration import ConfigurationResult

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
        write_rows(folder / name, *csv_rows(table))
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
    for contact in robot.contacts:
        yield from _components("contact", contact, "obstacle", _CONTACT)


def _components(
    part: str, of: Any, what: str, units: Mapping[str, str]
) -> Iterator[tuple[Any, ...]]:
    for key, unit in units.items():
        values = np.atleast_1d(getattr(of, key))
        for name, value in zip(_coordinates(key, len(values)), values, strict=True):
            yield part, of.name, what, name, value, unit


def csv_rows(table: Table) -> tuple[list[str], Iterable[tuple[str, ...]]]:
    """Return heads and rows of a table, in SI but for distances; none is empty."""
    heads, columns = [], []
    for column in table.columns:
        unit, factor, _ = QUANTITIES.get(str(column.quantity), ("", 1.0, 4))
        form = ".6f" if unit == "mm" else ".9g"
        heads.append(f"{column.title}_{unit}" if unit == "mm" else column.title)
        columns.append([_cell(value, factor, form) for value in column.values])
    return heads, zip(*columns, strict=True)


def _cell(value: Any, factor: float, form: str) -> str:
    if isinstance(value, str):
        return value
    if value is None or not math.isfinite(value):
        return ""
    return f"{factor * value:{form}}"


def write_rows(path: Path, heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write rows as CSV, so that no spreadsheet takes a text for a formula."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        for row in (heads, *rows):
            writer.writerow([as_cell(c) if isinstance(c, str) else c for c in row])


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
