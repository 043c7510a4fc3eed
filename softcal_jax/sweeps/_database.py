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
from dataclasses import replace
from functools import cache
from pathlib import Path
from threading import Lock, Timer
from typing import Any

from pydantic import TypeAdapter

from softcal_jax._files import check_file
from softcal_jax._places import only_writer
from softcal_jax.sweeps._result import SweepResult
from softcal_jax.sweeps._row import OUT_OF_RANGE, TrialRow
from softcal_jax.sweeps._trial import Trial

APPLICATION = 0x50F7CA1
"""SQLite's application_id, by which a database of a sweep is recognised."""

FORMAT = 1

APART_S = 1.0
"""Least time between two transactions, and most before a row is on disk [s]."""

WAIT_S = 30.0  # how long a row waits for another program that has the file locked [s]

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

_ROW = TypeAdapter(TrialRow)


@contextmanager
def sweep_database(path: Path) -> Iterator["SweepDatabase"]:
    """Open or make a database, to which no other sweep writes meanwhile."""
    with only_writer(path, "sweep"):
        with _explained(path):
            file = _open(path)
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
            known = dict(self.file.execute("SELECT what, value FROM definitions"))
            for what, value in definitions.items():  # new ones may be added
                if known.get(what, value) != value:
                    raise ValueError(
                        f"{self.path} holds another sweep: its {what} is {known[what]},"
                        f" that of this one is {value}. Give another file, or remove "
                        "it."
                    )
            self._write("definitions", list(definitions.items()))
            self._write("sweep", words)
            same = self.file.execute("SELECT * FROM plan ORDER BY number").fetchall()
            if same != plan:
                self.file.execute("DELETE FROM plan")
                self._write("plan", plan)
            return dict(self.file.execute("SELECT key, state FROM trials"))

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
        check_file(path, "sweep database")  # which says what it is instead
    # Not read-only, since a reader rolls back what a killed run left half done.
    uri = f"{path.resolve().as_uri()}?mode=rw"
    with _explained(path), closing(_open(uri, uri=True)) as file:
        file.execute("BEGIN")
        _check_format(file, path)
        texts = dict(file.execute("SELECT what, value FROM sweep"))
        texts |= file.execute("SELECT * FROM definitions WHERE what = 'truth'")
        plan = dict(file.execute("SELECT key, point FROM plan ORDER BY number"))
        rows = file.execute(
            f"SELECT {', '.join(f'trials.{name}' for name in _COLUMNS)} "
            "FROM trials LEFT JOIN plan ON plan.key = trials.key "
            "ORDER BY plan.number IS NULL, plan.number, trials.ended"
        )
        ended = {row[0]: row for row in rows}
    with _as_written(f"{path}, table sweep"):
        about = {what: json.loads(texts[what]) for what in ("name", "axes", "repeats")}
        axes = tuple(about["axes"])
        of_axes = lambda point: {axis: point[axis] for axis in axes}
        return SweepResult(
            name=about["name"],
            axes=axes,
            repeats=tuple(about["repeats"]),
            planned=_Read(path, plan, lambda text: of_axes(json.loads(text))),
            states={key: row[_OF_STATE] for key, row in ended.items()},
            ended=_Read(path, ended, lambda stored: _row(stored, of_axes)),
            truth=json.loads(texts.get("truth", "{}")),
        )


@contextmanager
def _as_written(where: str) -> Iterator[None]:
    """Name the place in errors about values that no sweep has written."""
    try:
        yield
    except (KeyError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(
            f"{where}: {error}. No sweep has written that: take an earlier copy of the "
            "file, or remove it to start anew."
        ) from error


class _Read(Mapping[str, Any]):
    """Values of the database by key, each read from its texts at the first use."""

    def __init__(self, path: Path, stored: Mapping[str, Any], read: Callable):
        self._path, self._stored, self._read = path, stored, cache(read)

    def __getitem__(self, key: str) -> Any:
        stored = self._stored[key]
        with _as_written(f"{self._path}, trial {key}"):
            return self._read(stored)

    def __iter__(self) -> Iterator[str]:
        return iter(self._stored)

    def __len__(self) -> int:
        return len(self._stored)


def _row(stored: Sequence[Any], of_axes: Callable) -> TrialRow:
    named = dict(zip(_COLUMNS, stored, strict=True))
    row = _ROW.validate_python(named | {k: json.loads(named[k]) for k in _AS_JSON})
    if Trial(row.point).key != row.key:
        raise ValueError(f"its point is {row.point}, which is not that of this key")
    beyond = lambda v: isinstance(v, int | float) and not abs(v) <= sys.float_info.max
    figures = {k: OUT_OF_RANGE if beyond(v) else v for k, v in row.figures.items()}
    return replace(row, point=of_axes(row.point), figures=figures)


def _open(database: str | Path, **options: Any) -> sqlite3.Connection:
    return sqlite3.connect(
        database,
        timeout=WAIT_S,
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
            "safe; the same sweep resumes from them."
        ) from error
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        raise ValueError(
            f"{path} is not a database of a sweep ({error}); give another file."
        ) from error
