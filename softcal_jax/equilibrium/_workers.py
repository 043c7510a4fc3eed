"""Compiled programs side by side, one on each core of this machine."""

import os
from collections.abc import Callable, Generator, Hashable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, ExitStack, nullcontext
from heapq import heappop, heappush
from queue import SimpleQueue
from threading import Lock
from typing import Any, NamedTuple, TypeVar

import jax

from softcal_jax._machine import available_cores
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver
from softcal_jax.equilibrium._model import Model

T = TypeVar("T")

_COMPILED: set[Hashable] = set()
"""Programs that have run in this process."""

_COMPILING: dict[Hashable, Lock] = {}
"""Held by the thread that compiles a program, while others wait for it."""


class Batch(NamedTuple):
    """Lanes of one program, which a job waits for.

    Attributes:
        function: Runs the program with a solver and the values of a lane, and waits for
            its end.
        lanes: What it is called with, one entry per lane.
        program: Key of the program, see `program_key`: one thread compiles a new one,
            and the others wait for it.
    """

    function: Callable[[AbstractLinearSolver, Any], Any]
    lanes: Sequence[Any]
    program: Hashable


Job = Generator[Batch, list[Any], T]
"""Asks for batches one after the other, is sent their results, and returns its end."""


def program_key(name: str, *arguments: Any) -> Hashable:
    """What tells one compiled program from another.

    Args:
        name: Name of the function.
        arguments: What all its lanes share; arrays count by shape and type alone.
    """
    leaves, tree = jax.tree.flatten(arguments)
    kind = lambda leaf: (leaf.shape, leaf.dtype) if hasattr(leaf, "dtype") else leaf
    return name, tree, tuple(map(kind, leaves))


def usable_cores() -> int:
    """Cores that this process may use; fewer than the machine has under a scheduler.

    A process that was told to use fewer threads (`OMP_NUM_THREADS`) shares the machine
    with others, like the workers of a sweep.
    """
    n = available_cores()
    told = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    return min(n, int(told)) if told.isdigit() and int(told) else n


class Workers:
    """Context with threads that share the lanes of all jobs that are under way.

    Each thread takes whole lanes, on one core, with a sparse solver of its own: two
    threads on the factors of one would overwrite each other's. Which thread takes a
    lane changes nothing in its result.

    Attributes:
        n: Number of threads; with one, everything runs in the thread of the caller,
            and the sparse solver keeps all cores. It is one where the solver does not
            run in threads.
    """

    def __init__(self, model: Model, lanes: int, n: int | None = None):
        """Threads for jobs.

        Args:
            model: The body, whose sparse solver they need.
            lanes: Lanes of all jobs; there are no more threads than these.
            n: Threads; by default as many as there are cores.

        Raises:
            ValueError: If `n` is less than one.
        """
        if n is not None and n < 1:
            raise ValueError(f"the number of workers must be at least 1, got {n}.")
        self._solver = model.solver
        wanted = usable_cores() if n is None else n
        self.n = max(1, min(wanted, lanes)) if self._solver.runs_in_threads else 1
        self._free: SimpleQueue[AbstractLinearSolver] = SimpleQueue()

    def __enter__(self) -> "Workers":
        if self.n > 1:
            self._pool = ThreadPoolExecutor(self.n)
            with self._solver.on_one_core():
                for k in range(1, self.n + 1):
                    self._free.put(jax.block_until_ready(self._solver.another(k)))
        return self

    def __exit__(self, *error) -> None:
        if self.n > 1:
            self._pool.shutdown(cancel_futures=True)

    def end_of(self, job: Job[T]) -> T:
        """Run one job and return its end.

        Args:
            job: The job, see `ends`.
        """
        return self.ends([job])[0]

    def ends(
        self, jobs: Iterable[Job[T]], told: Callable[[int, T], None] | None = None
    ) -> list[T]:
        """Run jobs, their lanes side by side, and return their ends in their order.

        Lanes of an earlier job go first, and a job begins when those of the others do
        not fill the threads: so jobs end one after the other, each leaves its place to
        the next, and few are lost if this is interrupted. Between its batches a job
        computes in the thread of the caller.

        Args:
            jobs: Generators that yield a `Batch` and are sent its results.
            told: Called with the index of a job that has ended and what it returned.
        """
        return _Round(self, list(jobs), told or (lambda *_: None)).ends()

    def submit(self, batch: Batch, lane: int) -> Future:
        """Hand out one lane; with one worker its result is there at once.

        Args:
            batch: The batch.
            lane: Index of the lane.
        """
        if self.n > 1:
            return self._pool.submit(self._run, batch, lane)
        done: Future = Future()
        done.set_result(batch.function(self._solver, batch.lanes[lane]))
        return done

    def _run(self, batch: Batch, lane: int) -> Any:
        solver = self._free.get()
        call = lambda: batch.function(solver, batch.lanes[lane])
        try:
            if batch.program not in _COMPILED:
                with _COMPILING.setdefault(batch.program, Lock()):
                    if batch.program not in _COMPILED:
                        first = call()
                        _COMPILED.add(batch.program)
                        return first
            return call()
        finally:
            self._free.put(solver)

    def on_one_core(self) -> AbstractContextManager[None]:
        """Context in which the workers' solvers run."""
        return self._solver.on_one_core() if self.n > 1 else nullcontext()


class _Round:
    """Jobs on their way to their ends."""

    def __init__(self, workers: Workers, jobs: list[Job], told):
        self._workers, self._jobs, self._told = workers, jobs, told
        self._ends: list[Any] = [None] * len(jobs)
        self._to_begin = iter(range(len(jobs)))
        self._batches: dict[int, Batch] = {}
        self._found: dict[int, dict[int, Any]] = {}
        self._waiting: list[tuple[int, int]] = []  # a heap of (job, lane)
        self._under_way: dict[Future, tuple[int, int]] = {}
        self._one_core = ExitStack()
        # Twice as many as threads, so that none waits while a job computes its step.
        self._most = 2 * workers.n if workers.n > 1 else 1

    def ends(self) -> list[Any]:
        try:
            while self._fill():
                self._take()
            return self._ends
        finally:
            for future in self._under_way:
                future.cancel()
            wait(self._under_way)
            self._one_core.close()

    def _fill(self) -> bool:
        """Hand out lanes; return whether any is under way."""
        while len(self._under_way) < self._most:
            if self._waiting:
                if not self._under_way:
                    self._one_core.enter_context(self._workers.on_one_core())
                job, lane = heappop(self._waiting)
                future = self._workers.submit(self._batches[job], lane)
                self._under_way[future] = job, lane
            elif (job := next(self._to_begin, None)) is not None:
                self._go_on(job, None)
            else:
                break
        return bool(self._under_way)

    def _take(self) -> None:
        """Wait for lanes, and send each job the batch that is complete with them."""
        done, _ = wait(self._under_way, return_when=FIRST_COMPLETED)
        places = {future: self._under_way.pop(future) for future in done}
        if not self._under_way:
            # What the caller computes between batches may take all cores again.
            self._one_core.close()
        for future, (job, lane) in places.items():
            found = self._found[job]
            found[lane] = future.result()
            if len(found) == len(self._batches[job].lanes):
                self._go_on(job, [found[k] for k in range(len(found))])

    def _go_on(self, job: int, found: list[Any] | None) -> None:
        try:
            # A generator that has just begun takes None.
            batch = self._jobs[job].send(found)  # pyright: ignore[reportArgumentType]
        except StopIteration as end:
            self._ends[job] = end.value
            self._told(job, end.value)
            return
        jax.block_until_ready(batch.lanes)  # so that no thread waits for them
        self._batches[job], self._found[job] = batch, {}
        for lane in range(len(batch.lanes)):
            heappush(self._waiting, (job, lane))
