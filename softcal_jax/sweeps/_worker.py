"""Processes that run trials: workers on this machine, or of a Dask cluster."""

import multiprocessing
import os
import pickle
import signal
import threading
import uuid
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from importlib.metadata import version
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING

import jax

from softcal_jax._compilation_cache import use_compilation_cache
from softcal_jax.sweeps._row import TrialFunction, TrialRow, failed_row, run_trial
from softcal_jax.sweeps._trial import Trial

if TYPE_CHECKING:
    import distributed

DEATHS = 2  # number of workers that must die during a trial for it to count as failed

_THREADS = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "LP_NUM_THREADS",  # of the renderer of Mesa
)

# JAX does not survive a fork.
_SPAWN = multiprocessing.get_context("spawn")

CONNECT_S = 20  # how long the scheduler may take to answer [s]

_ONE_AT_A_TIME = threading.Lock()
"""Held while a trial runs: threads share compiled programs and the solvers' factors."""


def set_up(*, x64: bool, sweep: str) -> None:
    """Make this process compute like the sweep's, whose version is to be the same."""
    installed = version("softcal-jax")
    if installed != sweep:
        raise RuntimeError(
            f"the worker has softcal_jax {installed}, the sweep {sweep}: rows would "
            "not belong together. Install the same version on both."
        )
    jax.config.update("jax_enable_x64", x64)
    use_compilation_cache(quickly=False)


def _like_this_process() -> Callable[[], None]:
    """Return what a worker calls before it computes."""
    x64 = bool(jax.config.read("jax_enable_x64"))
    return partial(set_up, x64=x64, sweep=version("softcal-jax"))


@contextmanager
def threads_of_children(n: int) -> Iterator[None]:
    """Make processes that are started inside use n threads each.

    The number must be in their environment before they load anything. It changes how
    sums are rounded, so it is the same however many workers there are.
    """
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, str(n)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def local_rows(
    function: TrialFunction, trials: Sequence[Trial], n: int, cores: int
) -> Generator[TrialRow, None, None]:
    """Run trials in n worker processes, and yield their rows in the order of their end.

    Each worker has `cores` threads. Closing the generator ends the workers.
    """
    sent, waiting, deaths = _pickled(function), deque(trials), Counter[str]()
    workers: list[_Worker] = []
    failed_starts = 0
    try:
        workers += [_Worker(sent, cores) for _ in range(min(n, len(trials)))]
        while waiting or any(worker.trial for worker in workers):
            heard = wait([worker.connection for worker in workers])
            for worker in [w for w in workers if w.connection in heard]:
                trial = worker.trial
                try:
                    row = worker.hear()
                except EOFError:  # it has died
                    failed_starts += not worker.ready
                    worker.check_start(failed_starts)
                    workers[workers.index(worker)] = _Worker(sent, cores)
                    if trial is None:
                        continue
                    deaths[trial.key] += 1
                    if deaths[trial.key] < DEATHS:
                        waiting.appendleft(trial)
                    else:
                        how = f"its worker died {DEATHS} times: {worker.end()}"
                        yield failed_row(trial, how)
                else:
                    failed_starts = 0
                    if row is not None:
                        yield row
                    if waiting:
                        worker.give(waiting.popleft())
    finally:
        for worker in workers:
            worker.stop()


def _pickled(function: TrialFunction) -> bytes:
    try:
        return pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ValueError(
            f"the function of the sweep cannot be sent to worker processes ({error}): "
            "define it with `def` in a module, or run it in this process, workers=0."
        ) from error


class _Worker:
    """A worker process, and the trial that it runs."""

    def __init__(self, function: bytes, cores: int):
        self.trial: Trial | None = None
        self.ready = False
        self.connection, other = _SPAWN.Pipe()
        self.process = _SPAWN.Process(
            target=_work, args=(other, function, _like_this_process()), daemon=True
        )
        with threads_of_children(cores):
            self.process.start()
        # The worker then holds the only other end: its death closes the connection.
        other.close()

    def give(self, trial: Trial) -> None:
        """Give the worker, which has none, a trial."""
        self.trial = trial
        with suppress(OSError):  # it has died, which `hear` finds next
            self.connection.send(trial)

    def hear(self) -> TrialRow | None:
        """Receive a row, or None once it is ready; raise EOFError if it has died."""
        try:
            heard = self.connection.recv()
        except (EOFError, OSError) as error:
            self.process.join()
            raise EOFError from error
        if isinstance(heard, RuntimeError):
            raise heard
        self.trial, self.ready = None, True
        return heard

    def check_start(self, failed_starts: int) -> None:
        """Raise RuntimeError if workers exit, or keep dying, before they are ready."""
        code = self.process.exitcode or 0
        if not self.ready and (code >= 0 or failed_starts > DEATHS):
            raise RuntimeError(
                f"a worker process ended before its first trial: {self.end()}. What it "
                "printed stands above. A script must begin its sweep below "
                '`if __name__ == "__main__":`, since worker processes import it.'
            )

    def end(self) -> str:
        """Say how its process ended."""
        code = self.process.exitcode or 0
        if code >= 0:
            return f"exit code {code}"
        return f"{signal.Signals(-code).name} (out of memory, or killed)"

    def stop(self) -> None:
        """End its process; an idle one exits by itself once its connection closes."""
        self.connection.close()
        if self.trial is None and self.ready:
            self.process.join(10.0)
        self.process.kill()
        self.process.join()
        self.process.close()


def _work(connection: Connection, function: bytes, setup: Callable[[], None]) -> None:
    """Run trials in a worker process until the connection closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    threading.Thread(target=_end_with_parent, daemon=True).start()
    setup()
    try:
        call = pickle.loads(function)
    except Exception as error:  # whatever an import can raise
        text = (
            f"a worker process cannot import the function of the sweep: {error!r}. "
            "Define it in a module that can be imported, or run it in this process, "
            "workers=0."
        )
        connection.send(RuntimeError(text))
        return
    connection.send(None)  # it is ready
    with suppress(EOFError):
        while True:
            connection.send(run_trial(call, connection.recv()))


def _end_with_parent() -> None:
    """End this worker when the process of the sweep ends, even if it was killed."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


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

    setup, run = _like_this_process(), uuid.uuid4().hex[:8]
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
            "were written are safe; the same sweep resumes from them."
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


def _run(function: TrialFunction, trial: Trial, setup: Callable[[], None]) -> TrialRow:
    """Run a trial on a worker of the cluster."""
    with _ONE_AT_A_TIME:
        setup()
        return run_trial(function, trial)
