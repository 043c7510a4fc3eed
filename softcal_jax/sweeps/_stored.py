"""What a database of a sweep holds, checked: it may have been edited by hand."""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from softcal_jax.sweeps._result import SweepResult
from softcal_jax.sweeps._row import TrialRow
from softcal_jax.sweeps._trial import Point, Trial

COLUMNS = tuple(TrialRow.__dataclass_fields__)
AS_JSON = ("point", "figures", "notes")
"""Columns of the table of trials, and those whose texts are JSON."""

_ABOUT = {
    "name": TypeAdapter(str),
    "axes": TypeAdapter(tuple[str, ...]),
    "repeats": TypeAdapter(tuple[str, ...]),
}
_POINT = TypeAdapter(Point)
_ROW = TypeAdapter(TrialRow)


def stored_sweep(file: sqlite3.Connection, path: Path) -> SweepResult:
    """Read everything from an open database.

    Raises:
        ValueError: If something in it was not written by a sweep; the text names it.
    """
    with _told(path):
        found = dict(file.execute("SELECT what, value FROM sweep"))
        about = {what: _word(what, found.get(what)) for what in _ABOUT}
        axes = about["axes"]
        query = "SELECT key, point FROM plan ORDER BY number"
        planned = {key: _planned(key, text, axes) for key, text in file.execute(query)}
        rows = file.execute(
            f"SELECT {', '.join(f'trials.{name}' for name in COLUMNS)} "
            "FROM trials LEFT JOIN plan ON plan.key = trials.key "
            "ORDER BY plan.number IS NULL, plan.number, trials.ended"
        )
        return SweepResult(
            **about, planned=planned, rows=tuple(_row(row, axes) for row in rows)
        )


class _EditedError(Exception):
    """Something that a sweep would not have written: its place, and what is wrong."""


@contextmanager
def _told(path: Path) -> Iterator[None]:
    try:
        yield
    except _EditedError as error:
        raise ValueError(
            f"{path}: {error}. No sweep has written that: take an earlier copy of the "
            "file, or remove it to start anew."
        ) from error


def _word(what: str, text: Any) -> Any:
    where = f"sweep.{what}"
    return _checked(where, _ABOUT[what], _parsed(where, text))


def _planned(key: str, text: Any, axes: tuple[str, ...]) -> Point:
    where = f"plan.{key}"
    point = _checked(f"{where}.point", _POINT, _parsed(f"{where}.point", text))
    _check_point(where, key, point, axes)
    return point


def _row(values: tuple[Any, ...], axes: tuple[str, ...]) -> TrialRow:
    named = dict(zip(COLUMNS, values, strict=True))
    where = f"trials.{named['key']}"
    parsed = {name: _parsed(f"{where}.{name}", named[name]) for name in AS_JSON}
    row = _checked(where, _ROW, named | parsed)
    _check_point(where, row.key, row.point, axes)
    for name, figure in row.figures.items():
        try:
            float(0 if isinstance(figure, str | None) else figure)
        except OverflowError as error:
            wrong = f"{where}.figures.{name} is a number that is too large"
            raise _EditedError(wrong) from error
    return row


def _parsed(where: str, text: Any) -> Any:
    """Parse a text of JSON."""
    try:
        return json.loads(text)
    except (TypeError, ValueError, RecursionError) as error:
        raise _EditedError(f"{where} is {_shown(text)}, which is no JSON") from error


def _checked(where: str, kind: TypeAdapter, value: Any) -> Any:
    """Convert a value to a type."""
    try:
        return kind.validate_python(value)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join([where, *map(str, first["loc"])])
        wrong = f"{place} is {_shown(first['input'])}: {first['msg']}"
        raise _EditedError(wrong) from error


def _check_point(where: str, key: str, point: Any, axes: tuple[str, ...]) -> None:
    """Raise unless a point has the axes of the sweep, and its own key."""
    try:
        own = set(point) == set(axes) and Trial(point).key
    except ValueError as error:
        raise _EditedError(f"{where}.point: {error}") from error
    if own != key:
        wrong = f"{where}.point is {_shown(point)}, which is not the point of this key"
        raise _EditedError(wrong)


def _shown(value: Any) -> str:
    """Write a value, shortened, on one line."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
