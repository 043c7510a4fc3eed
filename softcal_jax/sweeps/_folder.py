"""The folder of a sweep: a Parquet file of the trials that have ended, a row for each.

The process that runs the sweep, or a part of it, writes its file anew once a second at
most and puts it in place as a whole: nobody reads half a file, and a kill -9 loses the
rows of the last second. What has a name with a dot belongs to a sweep under way: its
lock, and the plan, which goes once all its trials have ended.
"""

import json
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from softcal_jax._files import check_file
from softcal_jax._places import check_place, only_writer, with_remedy
from softcal_jax.sweeps._result import Row, State, SweepResult
from softcal_jax.sweeps._trial import COLUMNS, Trial, shown

if TYPE_CHECKING:
    import pyarrow as pa

APART_S = 1.0
"""Time between two writes, and most before a row is on disk [s]."""

_ABOUT = b"softcal_jax.sweep"  # key of name, axes and definitions in a file's metadata


class RowFile:
    """The file of the sweep that runs: what is added is on disk within a second."""

    def __init__(self, path: Path, table: "pa.Table", plan: "pa.Table"):
        self.table, self._path, self._plan = table, path, plan
        self._waiting: list[Row] = []
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._failed = False
        self._write()
        self._thread = threading.Thread(target=self._keep_writing, daemon=True)
        self._thread.start()

    def add(self, row: Row) -> None:
        """Keep a row; raise OSError if earlier ones still cannot be written."""
        with self._lock:
            self._waiting.append(row)
            if self._failed:
                self._write()

    def close(self) -> None:
        """Write the rows that wait, and all in the order of the plan."""
        self._closed.set()
        self._thread.join()
        self._include()
        self.table = _in_order(self.table, self._plan)
        self._write()
        if not _left(self._plan, self.table):
            _plan_of(self._path).unlink(missing_ok=True)

    def _keep_writing(self) -> None:
        while not self._closed.wait(APART_S):
            with self._lock, suppress(OSError):  # which `add` or `close` will raise
                if self._waiting:
                    self._failed = True
                    self._write()

    def _include(self) -> None:
        """Move the rows that wait into the table."""
        import pyarrow as pa

        if self._waiting:
            types = {field.name: field.type for field in self._plan.schema}
            types |= _row_types()
            names = dict.fromkeys(name for row in self._waiting for name in row)
            values = lambda name: [row.get(name) for row in self._waiting]
            columns = {name: array(values(name), types.get(name)) for name in names}
            self.table = _below([self.table, pa.table(columns)])
            self._waiting = []

    def _write(self) -> None:
        self._include()
        # A figure that no trial has is no column.
        empty = [f.name for f in self.table.schema if str(f.type) == "null"]
        _write(self.table.drop_columns(empty), self._path)
        self._failed = False


@contextmanager
def row_file(
    path: Path,
    trials: Sequence[Trial],
    types: Mapping[str, "pa.DataType"],
    about: Mapping[str, Any],
    *,
    retry_failed: bool,
) -> Iterator[RowFile]:
    """Open or make the file of a sweep, which no other process writes meanwhile.

    Rows of earlier runs stay. `types` are those of the axes; `about` holds the name of
    the sweep, its axes, mere repetitions among them, and definitions: what rows depend
    on besides their points.

    Raises:
        ValueError: If the folder holds another sweep, or something else.
        OSError: If the file cannot be written, or another process writes it.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    folder = path.parent
    if folder.is_file():
        raise _no_folder(folder)
    if not folder.is_dir():
        check_place(folder)
    with with_remedy(f"{folder} cannot be made", "give another folder"):
        folder.mkdir(exist_ok=True)
    files = [*folder.glob("*.parquet")]
    other = [file.name for file in folder.iterdir() if file.name[0] != "."]
    if other and not files:
        raise ValueError(
            f"{folder} holds {other[0]}, and no rows of a sweep: give an empty folder, "
            "or one that does not exist yet."
        )
    with only_writer(path.with_name(f".{path.stem}"), "sweep"):
        columns = {a: array([t.point[a] for t in trials], types[a]) for a in types}
        plan = pa.table({**columns, "point": [trial.key for trial in trials]})
        schema = pa.schema([*plan.select([*types]).schema, *_row_types().items()])
        table = schema.empty_table()
        for file in [file for file in files if file != path][:1]:
            _check_same(file, _about(_read(file)), about)
        if path.exists():
            table = _read(path)
            before = _about(table)
            _check_same(path, before, about)
            definitions = {**before["definitions"], **about["definitions"]}
            about = {**about, "definitions": definitions}
        if retry_failed:
            table = table.filter(pc.field("state") != "failed")
        table = table.replace_schema_metadata({_ABOUT: json.dumps(about)})
        _write(plan, _plan_of(path))
        with closing(RowFile(path, table, plan)) as rows:
            yield rows


def read_sweep(folder: str | os.PathLike[str]) -> SweepResult:
    """Read the rows of a sweep, even while it runs.

    Raises:
        FileNotFoundError: If the folder does not exist.
        ValueError: If it is no folder of a sweep.
    """
    folder = Path(folder)
    if not folder.exists():
        check_file(folder, "folder of a sweep")  # which says what is similar
    if not folder.is_dir():
        raise _no_folder(folder)
    files = sorted(folder.glob("*.parquet"))
    if not files:
        raise ValueError(
            f"{folder} holds no rows of a sweep; name the folder that `softcal sweep` "
            "or `run_sweep` made."
        )
    return read_rows(files)


def read_rows(files: Sequence[Path]) -> SweepResult:
    """Read some files of a sweep, and what is left of their plans."""
    tables, missing = [], []
    for file in files:
        plan = None
        with suppress(FileNotFoundError):  # it goes when the last trial has ended
            plan = _parquet(_plan_of(file))
        table = _read(file)
        if plan is not None:
            table = _in_order(table, plan)
            missing += _left(plan, table)
        tables.append(table)
    about = _about(tables[0])
    axes = tuple(about["axes"])
    return SweepResult(
        name=about["name"],
        axes=axes,
        repeats=tuple(about["repeats"]),
        table=_below(tables),
        missing=tuple({axis: point[axis] for axis in axes} for point in missing),
        truth=json.loads(about["definitions"].get("truth", "{}")),
    )


def array(values: Sequence[Any], kind: "pa.DataType | None" = None) -> "pa.Array":
    """Make a column; of texts where its values are not of one kind."""
    import pyarrow as pa

    cell = lambda v: v if v is None else shown(v) if isinstance(v, list) else str(v)
    if kind is None and not any(isinstance(value, list) for value in values):
        with suppress(pa.ArrowInvalid, pa.ArrowTypeError, OverflowError):
            return pa.array(values)
    if kind is None or kind == pa.string():
        return pa.array([*map(cell, values)], pa.string())
    return pa.array(values, kind)


def _row_types() -> dict[str, "pa.DataType"]:
    import pyarrow as pa

    times = dict.fromkeys(("seconds", "compile_seconds"), pa.float64())
    texts = dict.fromkeys(COLUMNS, pa.string())
    return {**texts, **times, "notes": pa.list_(pa.string())}


def _below(tables: Sequence["pa.Table"]) -> "pa.Table":
    """Put tables below one another; numbers become texts if others have texts there."""
    import pyarrow as pa

    types: dict[str, list[pa.DataType]] = {}
    for field in (field for table in tables for field in table.schema):
        if field.type != pa.null():
            types.setdefault(field.name, []).append(field.type)
    numbers = pa.int64(), pa.float64()
    mixed = {
        name
        for name, (first, *more) in types.items()
        if any(kind != first for kind in more)
        and not all(kind in numbers for kind in (first, *more))
    }
    text = lambda f: f.with_type(pa.string()) if f.name in mixed else f
    cast = [t.cast(pa.schema(map(text, t.schema), t.schema.metadata)) for t in tables]
    return pa.concat_tables(cast, promote_options="permissive").combine_chunks()


def _in_order(table: "pa.Table", plan: "pa.Table") -> "pa.Table":
    """Put rows in the order of the plan; those that it does not have come last."""
    place = {point: i for i, point in enumerate(plan["point"].to_pylist())}
    of_row = [place.get(point, len(place)) for point in table["point"].to_pylist()]
    return table.take(np.argsort(of_row, kind="stable").astype(int))


def _left(plan: "pa.Table", table: "pa.Table") -> list[Row]:
    """Return what is planned and has no row."""
    ended = set(table["point"].to_pylist())
    return [point for point in plan.to_pylist() if point["point"] not in ended]


def _plan_of(path: Path) -> Path:
    return path.with_name(f".{path.stem}.plan")


def _write(table: "pa.Table", path: Path) -> None:
    """Write a file whole or not at all."""
    import pyarrow.parquet as pq

    partial = path.with_name(f".{path.stem}.partial")
    safe = "rows that were written are safe, and the same sweep resumes from them"
    with with_remedy(f"{path} cannot be written", safe):
        try:
            with partial.open("wb") as file:
                pq.write_table(
                    table, file, compression="zstd", write_page_checksum=True
                )
                file.flush()
                os.fsync(file.fileno())
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)


def _parquet(path: Path) -> "pa.Table":
    """Read a file of this folder, damaged or not by this package."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with path.open("rb") as file:
            table = pq.ParquetFile(file, page_checksum_verification=True).read()
        table.validate(full=True)
    except FileNotFoundError:
        raise
    except (pa.ArrowException, OSError, ValueError) as error:
        raise ValueError(
            f"{path} cannot be read ({error}): take an earlier copy of it, or remove "
            "it to run its trials again."
        ) from error
    return table


def _about(table: "pa.Table") -> dict[str, Any]:
    """Return what the sweep of some rows is."""
    return json.loads(table.schema.metadata[_ABOUT])


def _read(path: Path) -> "pa.Table":
    """Read rows; raise ValueError if they are not of a sweep."""
    table = _parquet(path)
    try:
        about = json.loads((table.schema.metadata or {})[_ABOUT])
        axes, _, _, _ = (about[k] for k in ("axes", "name", "repeats", "definitions"))
        types = {name: table.schema.field(name).type for name in (*axes, *COLUMNS)}
        states = set(table["state"].to_pylist())
        whole = types | _row_types() == types and states <= set(get_args(State))
    except (KeyError, TypeError, ValueError):
        whole = False
    if not whole:
        raise ValueError(
            f"{path} is no file of rows that a sweep has written; give another folder, "
            "or take the file out of it."
        )
    return table


def _check_same(path: Path, known: Mapping[str, Any], about: Mapping[str, Any]) -> None:
    """Raise ValueError if a file is of another sweep; definitions may be added."""
    for what, value in about["definitions"].items():
        other = known["definitions"].get(what, value)
        if other != value:
            raise ValueError(
                f"{path} is of another sweep: its {what} is {other}, that of this one "
                f"is {value}. Give another folder, or remove it."
            )


def _no_folder(path: Path) -> ValueError:
    """Build the error for a file where the folder of a sweep should be."""
    with path.open("rb") as file:
        if file.read(15) != b"SQLite format 3":
            return ValueError(f"{path} is a file; a sweep has its rows in a folder.")
    sweep = path.with_suffix(".toml")
    name = sweep if sweep.exists() else "SWEEP.toml"
    return ValueError(
        f"{path} is an SQLite database of an earlier version. Rows are now in a folder "
        f"of Parquet files, which `softcal sweep {name} -o {path.with_suffix('')}` "
        "makes anew."
    )
