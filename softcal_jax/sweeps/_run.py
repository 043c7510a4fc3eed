"""Running the trials of a sweep, into one database or as parts in Parquet files."""

import json
import os
import sys
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softcal_jax._files import digest_of
from softcal_jax._places import only_writer
from softcal_jax._text import check_known
from softcal_jax._units import is_number
from softcal_jax.equilibrium import usable_cores
from softcal_jax.sweeps._database import read_sweep, sweep_database
from softcal_jax.sweeps._result import SweepResult
from softcal_jax.sweeps._row import (
    Progress,
    TrialFunction,
    TrialRow,
    flat_columns,
    progress_of,
    run_trial,
)
from softcal_jax.sweeps._trial import Points, Range, Trial, as_trials, shown
from softcal_jax.sweeps._worker import dask_rows, local_rows

if TYPE_CHECKING:
    import pyarrow

_ABOUT = b"softcal_jax.sweep"  # key of what rows depend on, in the metadata of a file


def run_sweep(
    function: TrialFunction,
    points: Iterable[Mapping[str, Any]],
    database: str | os.PathLike[str],
    *,
    name: str | None = None,
    seed: int = 0,
    repeats: Sequence[str] = (),
    definitions: Mapping[str, str] | None = None,
    workers: int | None = None,
    cores_per_worker: int = 1,
    scheduler: str | None = None,
    retry_failed: bool = False,
    progress: Callable[[Progress], None] = lambda _: None,
) -> SweepResult:
    """Call a function at every point, side by side, and save each result.

    Each trial becomes a row of the database within a second of its end. To resume a
    sweep that was stopped or killed, run it again with the same arguments: only trials
    that were under way are lost, and after a kill those of the last second. A trial
    that raises becomes a row with the reason. A row depends on its point and the seed
    alone, not on the order or the number of workers.

    Example, in a module that can be imported::

        def tip_height(trial):
            E, noise = trial["E"], np.random.default_rng(trial.seed)
            ...
            return {"tip height [m]": height, "steps": steps}

        if __name__ == "__main__":
            points = grid({"E": [2e5, 3e5], "draw": range(20)})
            print(run_sweep(tip_height, points, "tips.sqlite", repeats=["draw"]))

    Args:
        function: Takes a `Trial` and returns figures by name, or an `Outcome`, which
            can say that it did not converge. Worker processes import it, and keep what
            it compiled from one trial to the next.
        points: Points from `grid`, `sample` or your own: a value for each axis. More
            points may be added when the sweep is run again.
        database: SQLite file; made, or continued.
        name: Name in tables; that of the function by default.
        seed: Seed of the sweep, see `Trial.seed`.
        repeats: Axes that only repeat trials, like draws; tables average over them.
        definitions: What else a row depends on, by name, like {"mesh": "beam 14x4x4"}.
            A database with another value of any of them is refused.
        workers: Number of worker processes; by default one per core. 0 runs everything
            in this process, for functions that cannot be imported.
        cores_per_worker: Threads of each worker. Their number changes how sums are
            rounded, so the last digits of rows may depend on it.
        scheduler: Address of a Dask scheduler, to use its workers instead.
        retry_failed: Whether to retry trials that failed.
        progress: Called at the beginning and after each trial.

    Returns:
        All rows of the database, those of earlier runs too.

    Raises:
        ValueError: If an argument is wrong, or the database is of another sweep.
        OSError: If the database or the scheduler cannot be used.
        RuntimeError: If workers cannot start.
    """
    trials = as_trials(points, seed)
    rests_on = _rests_on(function, trials, repeats, seed, definitions)
    run = rows_of(function, workers, cores_per_worker, scheduler)
    about = {"name": name or rests_on["function"], "repeats": tuple(repeats)}
    with sweep_database(Path(database)) as file:
        ended = file.begin(trials, about, rests_on)
        if retry_failed:
            ended = {key: s for key, s in ended.items() if s != "failed"}
        left = [trial for trial in trials if trial.key not in ended]
        before = [ended[trial.key] for trial in trials if trial.key in ended]
        with closing(run(left)) as rows:
            for now in progress_of(len(trials), before, rows if left else ()):
                if now.row is not None:
                    file.add(now.row)
                progress(now)
    return read_sweep(database)


def _rests_on(
    function: TrialFunction,
    trials: Sequence[Trial],
    repeats: Sequence[str],
    seed: int,
    definitions: Mapping[str, str] | None,
) -> dict[str, str]:
    """Return what rows depend on, by name, once the axes are known to be right."""
    axes = trials[0].point
    check_known("axis", axes, *repeats)
    return {
        "function": getattr(function, "__qualname__", type(function).__qualname__),
        "set of axes": ", ".join(sorted(axes)),
        "seed": str(seed),
        **(definitions or {}),
    }


def rows_of(
    function: TrialFunction,
    workers: int | None,
    cores_per_worker: int,
    scheduler: str | None,
) -> Callable[[Sequence[Trial]], Generator[TrialRow, None, None]]:
    """Choose what runs trials: a cluster, this process, or worker processes."""
    if cores_per_worker < 1:
        raise ValueError(
            f"cores_per_worker must be at least 1, got {cores_per_worker}."
        )
    if scheduler is not None:
        if workers is not None:
            raise ValueError(
                "workers are processes of this machine; with a scheduler the cluster "
                "has its own. Give one of the two."
            )
        return lambda trials: dask_rows(function, trials, scheduler)
    if workers is None:
        workers = max(1, usable_cores() // cores_per_worker)
    if workers < 0:
        raise ValueError(f"workers must be 0 or more, got {workers}.")
    if workers == 0:
        return lambda trials: (run_trial(function, trial) for trial in trials)
    return lambda trials: local_rows(function, trials, workers, cores_per_worker)


def run_part(
    function: TrialFunction,
    points: Points,
    folder: str | os.PathLike[str],
    *,
    part: int,
    of: int,
    seed: int = 0,
    repeats: Sequence[str] = (),
    definitions: Mapping[str, str] | None = None,
    workers: int | None = None,
    cores_per_worker: int = 1,
    scheduler: str | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
) -> Path:
    """Run one of several parts of a sweep, and write its rows as a Parquet file.

    Each job of a cluster runs one part, all write into one folder, and none waits for
    another. About 1 000 trials are a good size: a part that is killed begins anew. A
    part whose file exists is done; remove the file to run it again. Columns are the
    `number` of the point and those of the CSV of `run_sweep`: doubles where all values
    are numbers, texts elsewhere. A figure that no trial of a part has is not a column
    of its file, so read the columns of all parts by name.

    The `points` are those of the whole sweep, from `grid` or `sample`; `part` is the
    number of this part, from 0, and `of` the number of parts. All other arguments are
    as for `run_sweep`. Returns the path of the file in the `folder`.

    Raises:
        ValueError: If an argument is wrong, or the folder holds parts of another sweep.
        ImportError: If pyarrow is not installed.
        OSError: If the file cannot be written, or another process writes it.
        RuntimeError: If workers cannot start.
    """
    if not isinstance(points, Points):
        raise ValueError("points of a part must come from `grid` or `sample`.")
    if not 0 <= part < of <= len(points):
        raise ValueError(
            f"part {part} of {of}: expected a number from 0 to {of - 1}, of at most "
            f"{len(points)} parts, one for each trial."
        )
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ModuleNotFoundError as error:
        raise ImportError(
            "parts of a sweep are Parquet files: pip install 'softcal-jax[parquet]'."
        ) from error
    first, last = (len(points) * k // of for k in (part, part + 1))
    trials = as_trials(points[first:last], seed)
    rests_on = _rests_on(function, trials, repeats, seed, definitions)
    mark = json.dumps({**rests_on, "points": _digest(points), "parts": of}).encode()
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"part-{part:0{len(str(of - 1))}d}-of-{of}.parquet"
    run = rows_of(function, workers, cores_per_worker, scheduler)
    # The dot hides an unfinished file from programs that read the folder.
    partial = folder / f".{path.name}"
    with only_writer(partial, f"process with part {part}"):
        _check_folder(folder, mark)
        if path.exists():
            return path
        rows: dict[str, TrialRow] = {}
        with closing(run(trials)) as ended:
            for now in progress_of(len(trials), (), ended):
                if now.row is not None:
                    rows[now.row.key] = now.row
                progress(now)
        axes, *others = flat_columns([*points.axes], [rows[t.key] for t in trials])
        columns = {"number": pa.array(range(first, last))}
        for column, values in axes.items():
            words = not _has_numbers(points.axes[column])
            columns[column] = _array(values, words=words)
        for column, values in [item for group in others for item in group.items()]:
            if any(value is not None for value in values):
                unique = column + " of the trial" * (column in columns)
                columns[unique] = _array(values)
        table = pa.table(columns).replace_schema_metadata({_ABOUT: mark})
        try:
            pq.write_table(table, partial)
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    return path


def _digest(points: Points) -> str:
    """Digest all points: values of the axes, and which of them are taken."""
    plain = lambda v: vars(v) if isinstance(v, Range) else v
    axes = {axis: plain(values) for axis, values in points.axes.items()}
    text = json.dumps(axes, default=str)  # a `range` becomes its ends
    return digest_of([] if points.cells is None else [points.cells], text)


def _check_folder(folder: Path, mark: bytes) -> None:
    """Raise ValueError if the folder holds something else than parts of this sweep."""
    import pyarrow.parquet as pq

    other = next(folder.glob("part-*.parquet"), None)
    if other is None:
        return
    try:
        metadata = pq.read_schema(other).metadata or {}
    except (ValueError, OSError) as error:  # of Arrow, which does not name the file
        what = "cannot be read as a Parquet file. Remove it, or give another folder."
        raise ValueError(f"{other} {what}") from error
    if metadata.get(_ABOUT) != mark:
        raise ValueError(
            f"{other} is a part of another sweep: its project, points, seed or number "
            "of parts differ. Give another folder."
        )


def _has_numbers(axis: Sequence[Any] | Range) -> bool:
    if isinstance(axis, Range):
        return axis.form is None
    return isinstance(axis, range) or all(map(is_number, axis))


def _array(values: Sequence[Any], *, words: bool = False) -> "pyarrow.Array":
    """Make a column of doubles, or of texts where something is no number."""
    import pyarrow as pa

    most = sys.float_info.max
    fits = (v is None or (is_number(v) and abs(v) <= most) for v in values)
    if words or not all(fits):
        return pa.array([None if v is None else shown(v) for v in values], pa.string())
    return pa.array([None if v is None else float(v) for v in values], pa.float64())
