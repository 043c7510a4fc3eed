"""What a database of a sweep holds, checked: it may have been edited by hand."""

import sqlite3
import sys
from pathlib import Path
from typing import Any

from pydantic import Json, TypeAdapter, ValidationError

from softcal_jax._text import shortened
from softcal_jax.sweeps._result import SweepResult
from softcal_jax.sweeps._row import TrialRow
from softcal_jax.sweeps._trial import Point, Trial

COLUMNS = tuple(TrialRow.__dataclass_fields__)
AS_JSON = ("point", "figures", "notes")
"""Columns of the table of trials, and those whose texts are JSON."""

_ABOUT = {
    "name": TypeAdapter(Json[str]),
    "axes": TypeAdapter(Json[tuple[str, ...]]),
    "repeats": TypeAdapter(Json[tuple[str, ...]]),
}
_JSON = TypeAdapter(Json[Any])
_POINT = TypeAdapter(Json[Point])
_ROW = TypeAdapter(TrialRow)


def stored_sweep(file: sqlite3.Connection, path: Path) -> SweepResult:
    """Read everything from an open database.

    Raises:
        ValueError: If something in it was not written by a sweep; the text names it.
    """
    words = dict(file.execute("SELECT what, value FROM sweep"))
    plan = file.execute("SELECT key, point FROM plan ORDER BY number")
    rows = file.execute(
        f"SELECT {', '.join(f'trials.{name}' for name in COLUMNS)} "
        "FROM trials LEFT JOIN plan ON plan.key = trials.key "
        "ORDER BY plan.number IS NULL, plan.number, trials.ended"
    )
    try:
        about = {
            what: _checked(f"sweep.{what}", kind, words.get(what))
            for what, kind in _ABOUT.items()
        }
        planned = {
            key: _checked(f"plan.{key}.point", _POINT, text) for key, text in plan
        }
        ended = tuple(_row(dict(zip(COLUMNS, row, strict=True))) for row in rows)
        for key, point in [*planned.items(), *((row.key, row.point) for row in ended)]:
            if set(point) != set(about["axes"]) or Trial(point).key != key:
                raise ValueError(
                    f"{key}.point is {shortened(repr(point))}, which is not the point "
                    "of this key"
                )
    except ValueError as error:
        raise ValueError(
            f"{path}: {error}. No sweep has written that: take an earlier copy of the "
            "file, or remove it to start anew."
        ) from error
    return SweepResult(**about, planned=planned, rows=ended)


def _row(named: dict[str, Any]) -> TrialRow:
    where = f"trials.{named['key']}"
    parsed = {name: _checked(f"{where}.{name}", _JSON, named[name]) for name in AS_JSON}
    row = _checked(where, _ROW, named | parsed)
    for name, figure in row.figures.items():
        if isinstance(figure, int) and abs(figure) > sys.float_info.max:
            raise ValueError(f"{where}.figures.{name} is a number that is too large")
    return row


def _checked(where: str, kind: TypeAdapter, value: Any) -> Any:
    """Convert a value, or a text of JSON, to a type."""
    try:
        return kind.validate_python(value)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join([where, *map(str, first["loc"])])
        value = shortened(repr(first["input"]))
        raise ValueError(f"{place} is {value}: {first['msg']}") from error
