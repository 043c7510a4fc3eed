"""Trials on a Dask cluster."""

import threading
import uuid
from collections.abc import Generator, Sequence
from typing import TYPE_CHECKING

from softcal_jax.sweeps._row import TrialFunction, TrialRow, failed_row, run_trial
from softcal_jax.sweeps._trial import Trial
from softcal_jax.sweeps._worker import WorkerSetup

if TYPE_CHECKING:
    import distributed

CONNECT_S = 20
"""How long the scheduler may take to answer [s]."""

_ONE_AT_A_TIME = threading.Lock()
"""Held while a trial runs: threads share compiled programs and the solvers' factors."""


def dask_rows(
    function: TrialFunction, trials: Sequence[Trial], address: str
) -> Generator[TrialRow, None, None]:
    """Run trials on a Dask cluster, and yield their rows in the order of their ends.

    A trial whose worker dies is retried on another one, as often as Dask allows
    (`distributed.scheduler.allowed-failures`). Closing the generator cancels the trials
    that have not ended.
    """
    client = _connect(address)
    from distributed import as_completed

    setup, run = WorkerSetup.of_this_process(), uuid.uuid4().hex[:8]
    with client:
        try:
            # New keys, since a scheduler may still know those of a killed run.
            futures = {
                client.submit(
                    _run, function, trial, setup, key=f"trial-{trial.key}-{run}"
                ): trial
                for trial in trials
            }
        except TypeError as error:
            raise ValueError(
                f"the function of the sweep cannot be sent to a cluster: {error}."
            ) from error
        for future in as_completed(list(futures), loop=client.loop):
            yield _row(future, futures.pop(future), address)


def _row(future: "distributed.Future", trial: Trial, address: str) -> TrialRow:
    if future.status == "finished":
        return future.result()
    if future.status != "error":
        raise OSError(
            f"the Dask scheduler at {address} was lost ({future.status}). Rows that "
            "were written are safe; the same sweep goes on from them."
        )
    from distributed import KilledWorker

    error = future.exception()
    if isinstance(error, KilledWorker):
        deaths = error.allowed_failures + 1
        return failed_row(trial, f"its worker died {deaths} times")
    # Errors of the function make a row, so here the worker could not even call it.
    return failed_row(trial, f"its worker could not run it: {error!r}")


def _connect(address: str) -> "distributed.Client":
    try:
        from distributed import Client
    except ModuleNotFoundError as error:
        raise ValueError(
            "a Dask cluster needs Dask here too: pip install 'softcal-jax[dask]'."
        ) from error
    try:
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise OSError(
            f'no Dask scheduler answers at "{address}" ({error}). Expected the address '
            'that `dask scheduler` prints, like "tcp://10.0.0.1:8786".'
        ) from error


def _run(function: TrialFunction, trial: Trial, setup: WorkerSetup) -> TrialRow:
    """Run a trial on a worker of the cluster."""
    with _ONE_AT_A_TIME:
        setup.apply()
        return run_trial(function, trial)
