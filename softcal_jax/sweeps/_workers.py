"""What runs trials: this process, processes of its own, or an executor."""

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import (
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, partial
from importlib.metadata import version
from multiprocessing.connection import Connection

import jax

from softcal_jax._compilation_cache import use_compilation_cache
from softcal_jax.equilibrium import usable_cores
from softcal_jax.sweeps._result import Row
from softcal_jax.sweeps._row import TrialFunction, failed_row, run_trial
from softcal_jax.sweeps._trial import Trial

DEATHS = 2  # number of workers that must die during a trial for it to count as failed
CONNECT_S = 20  # how long a scheduler of Dask may take to answer [s]

_THREADS = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "LP_NUM_THREADS",  # of the renderer of Mesa
)
_SPAWN = multiprocessing.get_context("spawn")  # JAX does not survive a fork

_ONE_AT_A_TIME = threading.Lock()
"""Held while a trial runs: threads share compiled programs and the solvers' factors."""


def rows_of(
    function: TrialFunction,
    trials: Sequence[Trial],
    *,
    executor: Executor | str | None,
    workers: int | None,
    cores_per_worker: int,
) -> Generator[Row, None, None]:
    """Run trials, and yield their rows as they end; see `run_sweep` for where.

    Closing the generator ends the processes that it began, and cancels all trials that
    have not begun elsewhere.
    """
    if workers == 0:
        yield from (run_trial(function, trial) for trial in trials)
        return
    with ExitStack() as stack:
        if executor is None:
            workers = workers or max(1, usable_cores() // cores_per_worker)
            workers = min(workers, len(trials))
            context = _processes(_pickled(function), workers, cores_per_worker)
            submit = stack.enter_context(context)
        else:
            if isinstance(executor, str):
                client = stack.enter_context(_connect(executor))
                executor = client.get_executor(pure=False)
            is_pool = isinstance(executor, ProcessPoolExecutor)
            work = partial(_work, _pickled(function) if is_pool else function, _setup())
            submit = partial(executor.submit, work)
        futures: dict[Future[Row], Trial] = {}
        stack.callback(lambda: [future.cancel() for future in futures])
        for trial in trials:
            futures[submit(trial)] = trial
        for future in as_completed(list(futures)):
            yield _row_of(future, futures.pop(future))


def _row_of(future: "Future[Row]", trial: Trial) -> Row:
    """Return the row of a trial that has ended; raise if all others would end as it."""
    try:
        return future.result()
    except (CancelledError, BrokenProcessPool) as error:
        raise OSError(
            f"the executor was lost ({type(error).__name__}). Rows that were written "
            "are safe; the same sweep resumes from them."
        ) from error
    except RuntimeError:
        raise
    except Exception as error:  # of the executor: those of the function make a row
        return failed_row(trial, f"its worker could not run it: {error}")


def _setup() -> Callable[[], None]:
    """Return what a worker calls before it computes, to compute like this process."""
    x64 = bool(jax.config.read("jax_enable_x64"))
    return partial(set_up, x64=x64, sweep=version("softcal-jax"))


@cache
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


def _pickled(function: TrialFunction) -> bytes:
    try:
        return pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ValueError(
            f"the function of the sweep cannot be sent to worker processes ({error}): "
            "define it with `def` in a module, or run it in this process, workers=0."
        ) from error


@cache
def _imported(pickled: bytes) -> TrialFunction:
    try:
        return pickle.loads(pickled)
    except Exception as error:  # whatever an import can raise
        raise RuntimeError(
            f"a worker process cannot import the function of the sweep: {error!r}. "
            "Define it in a module that can be imported, or run it in this process, "
            "workers=0."
        ) from error


def _work(
    function: TrialFunction | bytes, setup: Callable[[], None], trial: Trial | None
) -> Row:
    """Run a trial in a worker, or without one only get ready for it."""
    with _ONE_AT_A_TIME:
        setup()
        call = _imported(function) if isinstance(function, bytes) else function
        return {} if trial is None else run_trial(call, trial)


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


@contextmanager
def _processes(
    function: bytes, n: int, cores: int
) -> Iterator[Callable[[Trial], Future[Row]]]:
    """Begin n threads, each with a process of its own for what is submitted.

    A pool of several processes ends them all where one dies. Here it is replaced, and
    its trial runs once more; no other trial is disturbed.
    """
    work, of_thread = partial(_work, function, _setup()), threading.local()

    def run(trial: Trial) -> Row:
        for _ in range(DEATHS):
            try:
                if not hasattr(of_thread, "pool"):
                    of_thread.pool = _begun(work, ears, pools)
                return of_thread.pool.submit(work, trial).result()
            except BrokenProcessPool:
                if lifeline.closed:
                    raise
                del of_thread.pool
        how = f"its worker died {DEATHS} times (out of memory, or killed)"
        return failed_row(trial, how)

    ears, lifeline = _SPAWN.Pipe(duplex=False)
    with ears, lifeline, threads_of_children(cores), ExitStack() as pools:
        threads = ThreadPoolExecutor(n)
        try:
            yield partial(threads.submit, run)
        except BaseException:
            lifeline.close()  # ends the processes, whatever they compute
            raise
        finally:
            threads.shutdown(cancel_futures=True)


def _begun(
    work: Callable[[Trial | None], Row], ears: Connection, pools: ExitStack
) -> ProcessPoolExecutor:
    """Return a pool of one process that is ready."""
    for _ in range(DEATHS):
        pool = ProcessPoolExecutor(
            1, mp_context=_SPAWN, initializer=_begin, initargs=(ears,)
        )
        pools.enter_context(pool)
        with suppress(BrokenProcessPool):
            pool.submit(work, None).result()
            return pool
    raise RuntimeError(
        "a worker process ended before its first trial. What it printed stands above. "
        'A script must begin its sweep below `if __name__ == "__main__":`, since '
        "worker processes import it."
    )


def _begin(ears: Connection) -> None:
    """Let only the parent handle Ctrl-C, and end this worker when the sweep ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_sweep, args=(ears,), daemon=True).start()


def _end_with_sweep(ears: Connection) -> None:
    try:
        ears.recv()
    except EOFError:  # the other end is closed, or its process was killed
        os._exit(1)


def _connect(address: str):
    """Return the client of a Dask scheduler."""
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
