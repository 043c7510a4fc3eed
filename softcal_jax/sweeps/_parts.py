"""Parts of a sweep that is too large for one database, each a Parquet file."""

import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softcal_jax._files import digest_of
from softcal_jax._places import only_writer
from softcal_jax.sweeps._progress import Progress, Tally
from softcal_jax.sweeps._row import TrialFunction, flat_columns
from softcal_jax.sweeps._run import about_sweep, rows_of
from softcal_jax.sweeps._trial import Points, Range, as_trials, is_number, shown

if TYPE_CHECKING:
    import pyarrow

_ABOUT = b"softcal_jax.sweep"
"""Key of what rows depend on, in the metadata of a file."""


def run_part(
    function: TrialFunction,
    points: Points,
    folder: str | os.PathLike[str],
    *,
    part: int,
    of: int,
    name: str | None = None,
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
    _, rests_on = about_sweep(function, trials, name, repeats, seed, definitions)
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
        tally, rows = Tally(len(trials), []), {}
        progress(tally.now())
        with closing(run(trials)) as ended:
            for row in ended:
                rows[row.key] = row
                progress(tally.now(row))
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
