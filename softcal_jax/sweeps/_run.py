"""Running the trials of a sweep that are left to do."""

import os
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from softcal_jax._names import unknown_name
from softcal_jax.equilibrium import usable_cores
from softcal_jax.sweeps._dask import dask_rows
from softcal_jax.sweeps._database import read_sweep, sweep_database
from softcal_jax.sweeps._progress import Progress, Tally
from softcal_jax.sweeps._result import SweepResult
from softcal_jax.sweeps._row import TrialFunction, TrialRow, run_trial
from softcal_jax.sweeps._trial import Trial, as_trials
from softcal_jax.sweeps._worker import local_rows


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
    about, rests_on = about_sweep(function, trials, name, repeats, seed, definitions)
    run = rows_of(function, workers, cores_per_worker, scheduler)
    with sweep_database(Path(database)) as file:
        ended = file.begin(trials, about, rests_on)
        if retry_failed:
            ended = {key: s for key, s in ended.items() if s != "failed"}
        left = [trial for trial in trials if trial.key not in ended]
        tally = Tally(len(trials), [ended[t.key] for t in trials if t.key in ended])
        progress(tally.now())
        if left:
            with closing(run(left)) as rows:
                for row in rows:
                    file.add(row)
                    progress(tally.now(row))
    return read_sweep(database)


def about_sweep(
    function: TrialFunction,
    trials: Sequence[Trial],
    name: str | None,
    repeats: Sequence[str],
    seed: int,
    definitions: Mapping[str, str] | None,
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return name and repetitions of a sweep, and what its rows depend on, by name."""
    axes = trials[0].point
    for axis in repeats:
        if axis not in axes:
            raise unknown_name("axis", axis, axes)
    what = getattr(function, "__qualname__", type(function).__qualname__)
    rests_on = {
        "function": what,
        "set of axes": ", ".join(sorted(axes)),
        "seed": str(seed),
        **(definitions or {}),
    }
    return {"name": name or what, "repeats": tuple(repeats)}, rests_on


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
