"""Worker processes on this machine."""

import multiprocessing
import multiprocessing.connection
import os
import pickle
import signal
import threading
from collections import Counter, deque
from collections.abc import Generator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from softcal_jax.sweeps._row import TrialFunction, TrialRow, failed_row, run_trial
from softcal_jax.sweeps._trial import Trial
from softcal_jax.sweeps._worker import WorkerSetup, threads_of_children

DEATHS = 2
"""Number of workers that must die during a trial for it to count as failed."""

READY = "ready"

# JAX does not survive a fork.
_SPAWN = multiprocessing.get_context("spawn")


def local_rows(
    function: TrialFunction, trials: Sequence[Trial], n: int, cores: int
) -> Generator[TrialRow, None, None]:
    """Run trials in worker processes, and yield their rows in the order of their ends.

    Args:
        function: The function of the sweep; worker processes must be able to import it.
        trials: The trials.
        n: Number of worker processes.
        cores: Threads of each.

    Yields:
        A row as soon as its trial has ended. Closing the generator ends the workers.

    Raises:
        ValueError: If the function cannot be sent to another process.
        RuntimeError: If workers cannot start.
    """
    start = lambda: _Worker(pickled(function), cores)
    waiting, deaths = deque(trials), Counter[str]()
    workers: list[_Worker] = []
    failed_starts = 0
    try:
        workers += [start() for _ in range(min(n, len(trials)))]
        while waiting or any(worker.trial for worker in workers):
            for worker in workers:
                worker.give(waiting)
            for worker in _speaking(workers):
                said = worker.hear()
                if isinstance(said, TrialRow):
                    failed_starts = 0
                    yield said
                elif said is None:
                    failed_starts += not worker.ready
                    worker.check_start(failed_starts)
                    lost = worker.trial
                    workers[workers.index(worker)] = start()
                    if lost is None:
                        continue
                    deaths[lost.key] += 1
                    if deaths[lost.key] < DEATHS:
                        waiting.appendleft(lost)
                    else:
                        yield failed_row(
                            lost, f"its worker died {DEATHS} times: {worker.end()}"
                        )
    finally:
        for worker in workers:
            worker.stop()


def pickled(function: TrialFunction) -> bytes:
    """Pickle a function for another process.

    Raises:
        ValueError: If another process could not import it.
    """
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
            target=_work,
            args=(other, function, WorkerSetup.of_this_process()),
            daemon=True,
        )
        with threads_of_children(cores):
            self.process.start()
        # The worker then holds the only other end, so that its death ends the file.
        other.close()

    def give(self, waiting: deque[Trial]) -> None:
        """Give it the next trial, if it has none."""
        if self.ready and self.trial is None and waiting:
            self.trial = waiting.popleft()
            with suppress(OSError):  # it has died, which `hear` finds next
                self.connection.send(self.trial)

    def hear(self) -> TrialRow | str | None:
        """Receive a row, or that it is ready; None if it has died.

        Raises:
            RuntimeError: If it cannot import the function.
        """
        try:
            said: Any = self.connection.recv()
        except (EOFError, OSError):
            self.process.join()
            return None
        if isinstance(said, TrialRow):
            self.trial = None
        elif said == READY:
            self.ready = True
        else:
            raise RuntimeError(said)
        return said

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


def _speaking(workers: Sequence[_Worker]) -> list[_Worker]:
    """Wait for workers that have sent something or died, and return them."""
    by_connection = {worker.connection: worker for worker in workers}
    heard = multiprocessing.connection.wait(list(by_connection))
    return [worker for c, worker in by_connection.items() if c in heard]


def _work(connection: Connection, function: bytes, setup: WorkerSetup) -> None:
    """Run trials in a worker process until the connection closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    threading.Thread(target=_end_with_parent, daemon=True).start()
    setup.apply()
    try:
        call = pickle.loads(function)
    except Exception as error:  # whatever an import can raise
        connection.send(
            f"a worker process cannot import the function of the sweep: {error!r}. "
            "Define it in a module that can be imported, or run it in this process, "
            "workers=0."
        )
        return
    connection.send(READY)
    while True:
        try:
            trial = connection.recv()
        except EOFError:
            return
        connection.send(run_trial(call, trial))


def _end_with_parent() -> None:
    """End this worker when the process of the sweep ends, even if it was killed."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
