"""Running the trials of a sweep into a folder."""

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softcal_jax._files import digest_of
from softcal_jax._text import check_known
from softcal_jax.sweeps._folder import array, read_rows, read_sweep, row_file
from softcal_jax.sweeps._result import SweepResult
from softcal_jax.sweeps._row import Progress, TrialFunction, progress_of
from softcal_jax.sweeps._trial import Points, Range, as_trials, plain
from softcal_jax.sweeps._workers import rows_of

if TYPE_CHECKING:
    import pyarrow as pa


def run_sweep(
    function: TrialFunction,
    points: Iterable[Mapping[str, Any]],
    folder: str | os.PathLike[str],
    *,
    name: str | None = None,
    seed: int = 0,
    repeats: Sequence[str] = (),
    definitions: Mapping[str, str] | None = None,
    executor: Executor | str | None = None,
    workers: int | None = None,
    cores_per_worker: int = 1,
    part: tuple[int, int] = (0, 1),
    retry_failed: bool = False,
    progress: Callable[[Progress], None] = lambda _: None,
) -> SweepResult:
    """Call a function at every point, side by side, and save each result.

    Each trial becomes a row of a Parquet file within a second of its end. To resume a
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
            print(run_sweep(tip_height, points, "tips", repeats=["draw"]))

    Args:
        function: Takes a `Trial` and returns figures by name, or an `Outcome`, which
            can say that it did not converge. Worker processes import it, and keep what
            it compiled from one trial to the next.
        points: Points from `grid`, `sample` or your own: a value for each axis. More
            points may be added when the sweep is run again.
        folder: Folder of the rows; made, or continued.
        name: Name in tables; that of the function by default.
        seed: Seed of the sweep, see `Trial.seed`.
        repeats: Axes that only repeat trials, like draws; tables average over them.
        definitions: What else a row depends on, by name, like {"mesh": "beam 14x4x4"}.
            A folder with another value of any of them is refused.
        executor: What runs the trials, like a `ThreadPoolExecutor` or the
            `get_executor` of a Dask client, or the address of a Dask scheduler. By
            default worker processes of this machine. A process runs one trial at a
            time, since threads share what is compiled.
        workers: Number of worker processes; by default one per core. 0 runs everything
            in this process, for functions that cannot be imported.
        cores_per_worker: Threads of each worker. Their number changes how sums are
            rounded, so the last digits of rows may depend on it.
        part: Number k, from 0, of n parts. Each part of a large sweep can be a job of a
            cluster: all fill one folder, a file each, and none waits for another.
        retry_failed: Whether to retry trials that failed.
        progress: Called at the beginning and after each trial.

    Returns:
        All rows of the folder, or of the part alone, those of earlier runs too.

    Raises:
        ValueError: If an argument is wrong, or the folder is of another sweep.
        OSError: If the folder or the executor cannot be used.
        RuntimeError: If workers cannot start.
    """
    points = points if isinstance(points, Sequence) else tuple(points)
    k, n = part
    if part != (0, 1) and not 0 <= k < n <= len(points):
        raise ValueError(
            f"part {k} of {n}: expected a number from 0 to {n - 1}, of at most "
            f"{len(points)} parts, one for each trial."
        )
    first, last = (len(points) * edge // n for edge in (k, k + 1))
    trials = as_trials(points, range(first, last), seed)
    axes = tuple(trials[0].point)
    check_known("axis", axes, *repeats)
    _check_workers(executor, workers, cores_per_worker)
    known = {
        "function": getattr(function, "__qualname__", type(function).__qualname__),
        "set of axes": ", ".join(sorted(axes)),
        "seed": str(seed),
        "number of parts": str(n),
        **(definitions or {}),
    }
    if n > 1:  # the points of other parts are not listed here
        known["list of points"] = _digest(points)
    about = {"name": name or known["function"], "axes": axes, "repeats": [*repeats]}
    about["definitions"] = known
    file = f"rows-{k:0{len(str(n - 1))}d}-of-{n}" if n > 1 else "rows"
    path = Path(folder) / f"{file}.parquet"
    types = _types(points)
    with row_file(path, trials, types, about, retry_failed=retry_failed) as rows:
        columns = (rows.table[name].to_pylist() for name in ("point", "state"))
        ended = dict(zip(*columns, strict=True))
        left = [trial for trial in trials if trial.key not in ended]
        before = [ended[trial.key] for trial in trials if trial.key in ended]
        run = rows_of(
            function,
            left,
            executor=executor,
            workers=workers,
            cores_per_worker=cores_per_worker,
        )
        with closing(run):
            for now in progress_of(len(trials), before, run if left else ()):
                if now.row is not None:
                    rows.add(now.row)
                progress(now)
    return read_sweep(folder) if n == 1 else read_rows([path])


def _check_workers(
    executor: Executor | str | None, workers: int | None, cores: int
) -> None:
    if cores < 1:
        raise ValueError(f"cores_per_worker must be at least 1, got {cores}.")
    if workers is not None and workers < 0:
        raise ValueError(f"workers must be 0 or more, got {workers}.")
    if executor is not None and workers is not None:
        raise ValueError(
            "workers are processes of this machine; an executor, like the scheduler of "
            "a cluster, has its own. Give one of the two."
        )


def _digest(points: Sequence[Mapping[str, Any]]) -> str:
    """Digest all points; of `Points` the values of the axes, and which are taken."""
    if not isinstance(points, Points):
        return digest_of([], json.dumps(points, default=str))
    plain = lambda v: vars(v) if isinstance(v, Range) else v
    axes = {axis: plain(values) for axis, values in points.axes.items()}
    text = json.dumps(axes, default=str)  # a `range` becomes its ends
    return digest_of([] if points.cells is None else [points.cells], text)


def _types(points: Sequence[Mapping[str, Any]]) -> dict[str, "pa.DataType"]:
    """Choose the type of each axis, the same in all parts."""
    axes: Mapping[str, Any] = (
        points.axes
        if isinstance(points, Points)
        else {axis: [point.get(axis) for point in points] for axis in points[0]}
    )
    types = {}
    for axis, values in axes.items():
        if isinstance(values, Range):
            values = [values.at(0.0)]
        elif isinstance(values, range):  # which may be long
            values = values[:1]
        types[axis] = array([plain(axis, value) for value in values]).type
    return types
