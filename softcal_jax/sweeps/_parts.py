"""Parts of a sweep that is too large for one database, each a Parquet file."""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from softcal_jax._places import only_writer, partial_of
from softcal_jax.sweeps._progress import Progress, Tally
from softcal_jax.sweeps._row import TrialFunction, flat_columns
from softcal_jax.sweeps._run import about_sweep, rows_of
from softcal_jax.sweeps._trial import Point, as_trials

if TYPE_CHECKING:
    import pyarrow

_ABOUT = b"softcal_jax.sweep"
"""Key of what rows depend on besides their points, in the metadata of a file."""


def run_part(
    function: TrialFunction,
    points: Sequence[Point],
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
    another. About 1 000 trials are a good size: a part that is killed begins anew, and
    one whose file is there is done. A row is that of `run_sweep`, with the columns of
    its CSV and the `number` of its point; pandas and DuckDB read the folder as a table.

    The `points` are those of the whole sweep, made from their index as `grid` does it;
    `part` is the number of this part, from 0, and `of` that of all. All other arguments
    are as for `run_sweep`. Returns the path of the file in the `folder`.

    Raises:
        ValueError: If an argument is wrong, or the folder holds parts of another sweep.
        ImportError: If pyarrow is not installed.
        OSError: If the file cannot be written, or another process writes it.
        RuntimeError: If workers cannot start.
    """
    if not 0 <= part < of <= len(points):
        raise ValueError(
            f"part {part} of {of}: expected a number from 0 to {of - 1}, of at most "
            f"{len(points)} parts, one for each trial."
        )
    try:
        import pyarrow
    except ModuleNotFoundError as error:
        raise ImportError(
            "parts of a sweep are Parquet files: pip install 'softcal-jax[parquet]'."
        ) from error
    first, last = (len(points) * k // of for k in (part, part + 1))
    trials = as_trials((points[i] for i in range(first, last)), seed)
    about, rests_on = about_sweep(function, trials, name, repeats, seed, definitions)
    mark = json.dumps({**about, **rests_on, "trials": len(points), "parts": of})
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"part-{part:0{len(str(of - 1))}d}-of-{of}.parquet"
    _check_folder(folder, mark)
    if path.exists():
        return path
    run = rows_of(function, workers, cores_per_worker, scheduler)
    tally, rows = Tally(len(trials), []), {}
    with only_writer(path, "part"):
        progress(tally.now())
        with closing(run(trials)) as ended:
            for row in ended:
                rows[row.key] = row
                progress(tally.now(row))
        table = pyarrow.table(
            {"number": range(first, last)}
            | flat_columns([rows[trial.key] for trial in trials])
        )
        _write(table.replace_schema_metadata({_ABOUT: mark}), path)
    return path


def _check_folder(folder: Path, mark: str) -> None:
    """Raise ValueError if the folder holds a part of another sweep."""
    import pyarrow.parquet

    for other in folder.glob("part-*.parquet"):
        metadata = pyarrow.parquet.read_schema(other).metadata or {}
        if metadata.get(_ABOUT) != mark.encode():
            raise ValueError(
                f"{other} is a part of another sweep: its project, axes, seed or "
                "number of parts differ. Give another folder."
            )
        return


def _write(table: "pyarrow.Table", path: Path) -> None:
    """Write a table whole or not at all, with numbers of one type in all parts."""
    import pyarrow
    import pyarrow.parquet

    fields = []
    for field in table.schema:
        kinds = pyarrow.types.is_integer, pyarrow.types.is_null
        if field.name != "number" and any(kind(field.type) for kind in kinds):
            field = field.with_type(pyarrow.float64())
        fields.append(field)
    table = table.cast(pyarrow.schema(fields, table.schema.metadata))
    pyarrow.parquet.write_table(table, partial_of(path))
    os.replace(partial_of(path), path)
