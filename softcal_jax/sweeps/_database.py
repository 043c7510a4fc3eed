"""The SQLite file of a sweep: what is planned, and a row for each trial that ended.

Only the process that runs the sweep writes to it, one short transaction per row, with
a rollback journal: unlike SQLite's write-ahead log, that is safe on network file
systems too, and it survives kill -9.
"""

import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from softcal_jax.sweeps._row import TrialRow
from softcal_jax.sweeps._trial import Trial

APPLICATION = 0x50F7CA1
"""SQLite's application_id, by which a database of a sweep is recognised."""

FORMAT = 1

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
_AS_JSON = ("point", "figures", "notes")


@dataclass(frozen=True)
class Plan:
    """What a sweep is to do.

    Attributes:
        name: Its name.
        trials: All of its trials, in the order in which they begin.
        repeats: Axes whose values are mere repetitions.
        definitions: What rows depend on besides their points, by name.
    """

    name: str
    trials: tuple[Trial, ...]
    repeats: tuple[str, ...]
    definitions: Mapping[str, str]

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""
        return tuple(self.trials[0].point)


class SweepDatabase:
    """Context in which only one sweep writes to a database.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path):
        """Name a database, which is opened or made on entering the context.

        Args:
            path: The file.
        """
        self.path = path
        self._lock_path = path.with_name(path.name + ".lock")

    def __enter__(self) -> "SweepDatabase":
        if self.path.is_dir():
            raise IsADirectoryError(f"{self.path} is a folder; name a database in it.")
        if not self.path.parent.is_dir():
            raise FileNotFoundError(
                f"the folder {self.path.parent} of the database does not exist."
            )
        self._lock = self._locked()
        try:
            with _told(self.path):
                self._file = sqlite3.connect(
                    self.path, timeout=WAIT_S, isolation_level=None
                )
        except BaseException:
            self._unlock()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()
        self._unlock()

    def _locked(self) -> sqlite3.Connection:
        # An SQLite lock on a separate file is portable, ends with the process, and does
        # not block readers of the database itself.
        lock = sqlite3.connect(self._lock_path, timeout=0.0, isolation_level=None)
        try:
            lock.execute("BEGIN EXCLUSIVE")
        except sqlite3.OperationalError as error:
            lock.close()
            raise BlockingIOError(
                f"another sweep is writing to {self.path}: wait until it has ended, or "
                "give another file."
            ) from error
        return lock

    def _unlock(self) -> None:
        with suppress(PermissionError):  # Windows removes no open file
            self._lock_path.unlink(missing_ok=True)
        self._lock.close()

    def begin(self, plan: Plan) -> dict[str, str]:
        """Write what is planned; rows of earlier runs stay.

        Args:
            plan: The sweep.

        Returns:
            The state of each trial that has ended, by its key.

        Raises:
            ValueError: If the file is no database of a sweep, or of another one.
            BlockingIOError: If another program keeps it locked.
        """
        with _told(self.path):
            self._file.execute("BEGIN IMMEDIATE")
            try:
                self._prepare()
                self._check_definitions(plan)
                self._write(plan)
                rows = self._file.execute("SELECT key, state FROM trials").fetchall()
                self._file.execute("COMMIT")
            except BaseException:
                self._file.execute("ROLLBACK")
                raise
        return dict(rows)

    def _prepare(self) -> None:
        """Make the tables in a new file; refuse a file that is something else."""
        if self._file.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            check_format(self._file, self.path)
            return
        for statement in _TABLES.split(";\n"):
            self._file.execute(statement)
        self._file.execute(f"PRAGMA application_id = {APPLICATION}")
        self._file.execute(f"PRAGMA user_version = {FORMAT}")

    def _check_definitions(self, plan: Plan) -> None:
        """Raise if what rows depend on has changed; new definitions may be added."""
        known = dict(self._file.execute("SELECT what, value FROM definitions"))
        for what, value in plan.definitions.items():
            if known.get(what, value) != value:
                raise ValueError(
                    f"{self.path} holds another sweep: its {what} is {known[what]}, "
                    f"that of this one is {value}. Give another file, or remove it."
                )
        self._file.executemany(
            "INSERT OR REPLACE INTO definitions VALUES (?, ?)",
            plan.definitions.items(),
        )

    def _write(self, plan: Plan) -> None:
        about = {"name": plan.name, "axes": plan.axes, "repeats": plan.repeats}
        self._file.executemany(
            "INSERT OR REPLACE INTO sweep VALUES (?, ?)",
            [(what, json.dumps(value)) for what, value in about.items()],
        )
        self._file.execute("DELETE FROM plan")
        self._file.executemany(
            "INSERT INTO plan VALUES (?, ?, ?)",
            [(i, t.key, json.dumps(t.point)) for i, t in enumerate(plan.trials)],
        )

    def add(self, row: TrialRow) -> None:
        """Write a row, and return once it is on disk.

        Raises:
            BlockingIOError: If another program keeps the database locked.
        """
        values = [
            json.dumps(value) if name in _AS_JSON else value
            for name, value in ((name, getattr(row, name)) for name in _COLUMNS)
        ]
        marks = ", ".join("?" * len(_COLUMNS))
        with _told(self.path):
            self._file.execute(
                f"INSERT OR REPLACE INTO trials ({', '.join(_COLUMNS)}) "
                f"VALUES ({marks})",
                values,
            )


@dataclass(frozen=True)
class Content:
    """What a database holds.

    Attributes:
        about: Name, axes and repeated axes.
        planned: Points that are planned, by key, in their order.
        rows: Trials that have ended, in the order of the plan, then any others.
    """

    about: Mapping[str, Any]
    planned: Mapping[str, Mapping[str, Any]]
    rows: tuple[TrialRow, ...]


def read_content(path: Path) -> Content:
    """Read a database, even while a sweep writes to it.

    Args:
        path: The file.

    Raises:
        FileNotFoundError: If it does not exist.
        ValueError: If it is no database of a sweep.
        BlockingIOError: If another program keeps it locked.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no sweep database {path}.")
    # Not read-only, since a reader rolls back what a killed run left half done.
    uri = f"{path.resolve().as_uri()}?mode=rw"
    with _told(path):
        file = sqlite3.connect(uri, uri=True, timeout=WAIT_S, isolation_level=None)
        try:
            file.execute("BEGIN")
            check_format(file, path)
            about = {w: json.loads(v) for w, v in file.execute("SELECT * FROM sweep")}
            plan = file.execute("SELECT key, point FROM plan ORDER BY number")
            planned = {key: json.loads(point) for key, point in plan}
            rows = file.execute(
                f"SELECT {', '.join(f'trials.{name}' for name in _COLUMNS)} "
                "FROM trials LEFT JOIN plan ON plan.key = trials.key "
                "ORDER BY plan.number IS NULL, plan.number, trials.ended"
            ).fetchall()
        finally:
            file.close()
    return Content(about, planned, tuple(map(_row, rows)))


def _row(values: tuple[Any, ...]) -> TrialRow:
    named = dict(zip(_COLUMNS, values, strict=True))
    named |= {name: json.loads(named[name]) for name in _AS_JSON}
    return TrialRow(**{**named, "notes": tuple(named["notes"])})


def check_format(file: sqlite3.Connection, path: Path) -> None:
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
def _told(path: Path) -> Iterator[None]:
    """Turn errors of SQLite into errors that say what to do."""
    try:
        yield
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise BlockingIOError(
                f"the database {path} is locked by another program; close it there and "
                "run this again. Rows that were written are safe."
            ) from error
        raise OSError(f"the database {path} cannot be used: {error}.") from error
    except sqlite3.DatabaseError as error:
        raise ValueError(
            f"{path} is not a database of a sweep ({error}); give another file."
        ) from error
