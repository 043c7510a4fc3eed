"""What a database of a sweep holds, checked: it may have been edited by hand."""

import sqlite3
from pathlib import Path
from typing import Any

from pydantic import Json, TypeAdapter, ValidationError

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
        axes = about["axes"]
        planned = {key: _planned(key, text, axes) for key, text in plan}
        ended = tuple(_row(row, axes) for row in rows)
    except _EditedError as error:
        raise ValueError(
            f"{path}: {error}. No sweep has written that: take an earlier copy of the "
            "file, or remove it to start anew."
        ) from error
    return SweepResult(**about, planned=planned, rows=ended)


class _EditedError(Exception):
    """Something that a sweep would not have written: its place, and what is wrong."""


def _planned(key: str, text: Any, axes: tuple[str, ...]) -> Point:
    point = _checked(f"plan.{key}.point", _POINT, text)
    _check_point(f"plan.{key}", key, point, axes)
    return point


def _row(values: tuple[Any, ...], axes: tuple[str, ...]) -> TrialRow:
    named = dict(zip(COLUMNS, values, strict=True))
    where = f"trials.{named['key']}"
    parsed = {name: _checked(f"{where}.{name}", _JSON, named[name]) for name in AS_JSON}
    row = _checked(where, _ROW, named | parsed)
    _check_point(where, row.key, row.point, axes)
    for name, figure in row.figures.items():
        try:
            float(0 if isinstance(figure, str | None) else figure)
        except OverflowError as error:
            wrong = f"{where}.figures.{name} is a number that is too large"
            raise _EditedError(wrong) from error
    return row


def _checked(where: str, kind: TypeAdapter, value: Any) -> Any:
    """Convert a value, or a text of JSON, to a type."""
    try:
        return kind.validate_python(value)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join([where, *map(str, first["loc"])])
        wrong = f"{place} is {_shown(first['input'])}: {first['msg']}"
        raise _EditedError(wrong) from error


def _check_point(where: str, key: str, point: Any, axes: tuple[str, ...]) -> None:
    """Raise unless a point has the axes of the sweep, and the key of the row."""
    try:
        fits = set(point) == set(axes) and Trial(point).key == key
    except ValueError as error:
        raise _EditedError(f"{where}.point: {error}") from error
    if not fits:
        wrong = f"{where}.point is {_shown(point)}, which is not the point of this key"
        raise _EditedError(wrong)


def _shown(value: Any) -> str:
    """Write a value, shortened, on one line."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
