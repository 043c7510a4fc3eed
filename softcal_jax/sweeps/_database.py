"""The SQLite file of a sweep: what is planned, and a row for each trial that ended.

Only the process that runs the sweep writes to it, in short transactions with a rollback
journal: unlike SQLite's write-ahead log, that is safe on network file systems too, and
it survives kill -9. A transaction waits for the disk, which takes some 20 ms, so rows
that come faster than one a second share one; a kill loses those of the last second.
"""

import json
import math
import os
import sqlite3
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from threading import Lock, Timer
from typing import Any

from pydantic import Json, TypeAdapter, ValidationError

from softcal_jax._places import only_writer
from softcal_jax._text import shortened
from softcal_jax.sweeps._result import SweepResult
from softcal_jax.sweeps._row import State, TrialRow
from softcal_jax.sweeps._trial import Point, Trial

APPLICATION = 0x50F7CA1
"""SQLite's application_id, by which a database of a sweep is recognised."""

FORMAT = 1

APART_S = 1.0
"""Least time between two transactions, and most before a row is on disk [s]."""

WAIT_S = 30.0
"""How long a row waits for another program that has the file locked [s]."""

_TABLES = """\
CREATE TABLE sweep (what TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE definitions (what TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE plan (number INTEGER PRIMARY KEY, key TEXT UNIQUE, point TEXT NOT NULL);
CREATE TABLE trials (
    key TEXT PRIMARY KEY, point TEXT NOT NULL, state TEXT NOT NULL,
    reason TEXT NOT NULL, figures TEXT NOT NULL, notes TEXT NOT NULL,
    seconds REAL NOT NULL, compile_seconds REAL NOT NULL,
    worker TEXT NOT NULL, ended TEXT NOT NULL, traceback TEXT NOT NULL
);"""

_COLUMNS = tuple(TrialRow.__dataclass_fields__)
_AS_JSON, _OF_STATE = ("point", "figures", "notes"), _COLUMNS.index("state")
"""Columns of the table of trials, those whose texts are JSON, and that of the state."""

_NAME, _NAMES = TypeAdapter(Json[str]), TypeAdapter(Json[tuple[str, ...]])
_JSON, _POINT = TypeAdapter(Json[Any]), TypeAdapter(Json[Point])
_ROW, _STATE = TypeAdapter(TrialRow), TypeAdapter(State)


@contextmanager
def sweep_database(path: Path) -> Iterator["SweepDatabase"]:
    """Open or make a database, to which no other sweep writes meanwhile."""
    with only_writer(path, "sweep"):
        with _explained(path):
            file = _open(path, WAIT_S)
        with closing(file), closing(SweepDatabase(path, file)) as database:
            yield database


class SweepDatabase:
    """The database of the sweep that runs; its rows are on disk once it is closed."""

    def __init__(self, path: Path, file: sqlite3.Connection):
        self.path, self.file = path, file
        self._waiting: list[TrialRow] = []
        self._lock = Lock()
        self._written = -math.inf
        self._timer: Timer | None = None

    def begin(
        self,
        trials: Sequence[Trial],
        about: Mapping[str, Any],
        definitions: Mapping[str, str],
    ) -> dict[str, str]:
        """Write what is planned; return the states of trials that ended, by key.

        Rows of earlier runs stay. `about` holds the name of the sweep and the axes that
        are mere repetitions, `definitions` what rows depend on besides their points.
        """
        about = {**about, "axes": tuple(trials[0].point)}
        words = [(what, json.dumps(value)) for what, value in about.items()]
        plan = [(i, t.key, json.dumps(t.point)) for i, t in enumerate(trials)]
        with _explained(self.path), self.file:  # everything, or nothing
            self.file.execute("BEGIN IMMEDIATE")
            if self.file.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
                _check_format(self.file, self.path)
            else:
                for statement in _TABLES.split(";\n"):
                    self.file.execute(statement)
                self.file.execute(f"PRAGMA application_id = {APPLICATION}")
                self.file.execute(f"PRAGMA user_version = {FORMAT}")
            self._check_definitions(definitions)
            self._write("definitions", list(definitions.items()))
            self._write("sweep", words)
            same = self.file.execute("SELECT * FROM plan ORDER BY number").fetchall()
            if same != plan:
                self.file.execute("DELETE FROM plan")
                self._write("plan", plan)
            stored = _stored_sweep(self.file, self.path)
            _ = stored.rows, [*stored.planned.values()]  # raises if a user edited them
        return dict(stored.states)

    def _check_definitions(self, definitions: Mapping[str, str]) -> None:
        """Raise if what rows depend on has changed; new definitions may be added."""
        known = dict(self.file.execute("SELECT what, value FROM definitions"))
        for what, value in definitions.items():
            if known.get(what, value) != value:
                raise ValueError(
                    f"{self.path} holds another sweep: its {what} is {known[what]}, "
                    f"that of this one is {value}. Give another file, or remove it."
                )

    def _write(self, table: str, rows: Sequence[tuple[Any, ...]]) -> None:
        marks = ", ".join("?" * len(rows[0]))
        self.file.executemany(f"INSERT OR REPLACE INTO {table} VALUES ({marks})", rows)

    def add(self, row: TrialRow) -> None:
        """Write a row: at once, or within `APART_S` together with others."""
        with self._lock:
            self._waiting.append(row)
            left = self._written + APART_S - time.monotonic()
            if left <= 0.0:
                self._write_rows()
            elif self._timer is None:
                self._timer = Timer(left, self._in_time)
                self._timer.daemon = True
                self._timer.start()

    def close(self) -> None:
        """Write the rows that wait."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
            self._write_rows()

    def _in_time(self) -> None:
        """Write the rows that wait, in the thread of the timer."""
        # If that fails, the rows go on waiting; the next `add` or `close` raises.
        with self._lock, suppress(OSError, ValueError):
            self._timer = None
            self._write_rows()

    def _write_rows(self) -> None:
        rows = []
        for row in self._waiting:
            texts = {name: json.dumps(getattr(row, name)) for name in _AS_JSON}
            named = vars(row) | texts
            rows.append(tuple(named[name] for name in _COLUMNS))
        if rows:
            with _explained(self.path), self.file:
                self.file.execute("BEGIN IMMEDIATE")
                self._write("trials", rows)
            self._waiting.clear()
        self._written = time.monotonic()


def read_sweep(database: str | os.PathLike[str]) -> SweepResult:
    """Read a sweep, even while it runs; its rows are parsed when they are asked for.

    Args:
        database: The SQLite file.

    Raises:
        FileNotFoundError: If it does not exist.
        ValueError: If it is no database of a sweep.
        BlockingIOError: If another program keeps it locked.
    """
    path = Path(database)
    if not path.is_file():
        raise FileNotFoundError(f"there is no sweep database {path}.")
    # Not read-only, since a reader rolls back what a killed run left half done.
    uri = f"{path.resolve().as_uri()}?mode=rw"
    with _explained(path), closing(_open(uri, WAIT_S, uri=True)) as file:
        file.execute("BEGIN")
        _check_format(file, path)
        return _stored_sweep(file, path)


def _stored_sweep(file: sqlite3.Connection, path: Path) -> SweepResult:
    """Fetch everything from an open database; points and rows are read when asked for.

    What is read is checked, since the file may have been edited.
    """
    words = dict(file.execute("SELECT what, value FROM sweep"))
    plan = dict(file.execute("SELECT key, point FROM plan ORDER BY number"))
    rows = file.execute(
        f"SELECT {', '.join(f'trials.{name}' for name in _COLUMNS)} "
        "FROM trials LEFT JOIN plan ON plan.key = trials.key "
        "ORDER BY plan.number IS NULL, plan.number, trials.ended"
    )
    ended = {row[0]: row for row in rows}
    with _as_written(path):
        about = lambda what, kind: _checked(f"sweep.{what}", kind, words.get(what))
        name, axes = about("name", _NAME), about("axes", _NAMES)
        state = lambda row: _checked(f"trials.{row[0]}.state", _STATE, row[_OF_STATE])
        point = lambda key, text: _of_key(
            axes, key, _checked(f"plan.{key}.point", _POINT, text)
        )
        return SweepResult(
            name=name,
            axes=axes,
            repeats=about("repeats", _NAMES),
            planned=_Read(plan, point, path),
            states={key: state(row) for key, row in ended.items()},
            ended=_Read(ended, partial(_row, axes), path),
        )


class _Read(Mapping[str, Any]):
    """Values of the database by key, each read from its texts at the first use."""

    def __init__(self, stored: Mapping[str, Any], read: Callable, path: Path):
        self._stored = stored
        self._read = cache(_as_written(path)(lambda key: read(key, stored[key])))

    def __getitem__(self, key: str) -> Any:
        return self._read(key)

    def __iter__(self) -> Iterator[str]:
        return iter(self._stored)

    def __len__(self) -> int:
        return len(self._stored)


def _row(axes: Sequence[str], key: str, stored: Sequence[Any]) -> TrialRow:
    named, where = dict(zip(_COLUMNS, stored, strict=True)), f"trials.{key}"
    for name in _AS_JSON:
        named[name] = _checked(f"{where}.{name}", _JSON, named[name])
    row = _checked(where, _ROW, named)
    for name, figure in row.figures.items():
        if isinstance(figure, int) and abs(figure) > sys.float_info.max:
            raise ValueError(f"{where}.figures.{name} is a number that is too large")
    _of_key(axes, key, row.point)
    return row


def _of_key(axes: Sequence[str], key: str, point: Point) -> Point:
    if set(point) != set(axes) or Trial(point).key != key:
        raise ValueError(
            f"{key}.point is {shortened(repr(point))}, which is not the point of this "
            "key"
        )
    return point


@contextmanager
def _as_written(path: Path) -> Iterator[None]:
    """Name the file in errors about values that no sweep has written."""
    try:
        yield
    except ValueError as error:
        raise ValueError(
            f"{path}: {error}. No sweep has written that: take an earlier copy of the "
            "file, or remove it to start anew."
        ) from error


def _checked(where: str, kind: TypeAdapter, value: Any) -> Any:
    """Convert a value, or a text of JSON, to a type."""
    try:
        return kind.validate_python(value)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join([where, *map(str, first["loc"])])
        value = shortened(repr(first["input"]))
        raise ValueError(f"{place} is {value}: {first['msg']}") from error


def _open(database: str | Path, wait: float, **options: Any) -> sqlite3.Connection:
    return sqlite3.connect(
        database,
        timeout=wait,
        isolation_level=None,
        check_same_thread=False,  # a lock keeps out the thread of the timer
        **options,
    )


def _check_format(file: sqlite3.Connection, path: Path) -> None:
    """Raise ValueError unless an open file is a database of a sweep."""
    (application,) = file.execute("PRAGMA application_id").fetchone()
    (version,) = file.execute("PRAGMA user_version").fetchone()
    if application != APPLICATION:
        raise ValueError(
            f"{path} is a database of something else than a sweep; give another file."
        )
    if version != FORMAT:
        raise ValueError(
            f"{path} was written by another version of softcal_jax (format {version}, "
            f"this one reads {FORMAT}); give another file."
        )


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn errors of SQLite into errors that say what to do."""
    try:
        yield
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise BlockingIOError(
                f"the database {path} is locked by another program; close it there and "
                "run this again. Rows that were written are safe."
            ) from error
        raise OSError(
            f"the database {path} cannot be used: {error}. Rows that were written are "
            "safe; the same sweep goes on from them."
        ) from error
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        raise ValueError(
            f"{path} is not a database of a sweep ({error}); give another file."
        ) from error
