"""Compiled programs in parallel, one per core of this machine."""

import os
from collections.abc import Callable, Generator, Hashable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, ExitStack, nullcontext
from heapq import heappop, heappush
from queue import SimpleQueue
from threading import Lock, RLock
from typing import Any, NamedTuple, TypeVar

import jax

from softcal_jax._machine import available_cores
from softcal_jax._module import one_line
from softcal_jax._process import check_process
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver
from softcal_jax.equilibrium._model import Model

T = TypeVar("T")

_COMPILED: set[Hashable] = set()
"""Programs that have run since JAX last forgot what it had compiled."""

_TURN = RLock()
"""Held by the thread whose workers run: how many threads PARDISO uses, and the factors
of equal patterns, belong to the whole process."""

_COMPILING: dict[Hashable, Lock] = {}
"""Locks held by the thread that compiles a program, while others wait."""


@jax.jit
def _remembered():
    """Be forgotten by `jax.clear_caches`, as all other programs are."""


def _forget_as_jax() -> None:
    """Forget the programs that have run if `jax.clear_caches` was called."""
    if _remembered._cache_size() == 0:  # pyright: ignore[reportAttributeAccessIssue]
        _COMPILED.clear()
        _remembered()


class Batch(NamedTuple):
    """Lanes of one program whose results a job waits for.

    Attributes:
        function: Runs the program with a solver and a lane, and blocks until it ends.
        lanes: Arguments of the function, one entry per lane.
        program: Key from `program_key`; one thread compiles, while the others wait.
    """

    function: Callable[[AbstractLinearSolver, Any], Any]
    lanes: Sequence[Any]
    program: Hashable

    __repr__ = one_line


Job = Generator[Batch, list[Any], T]
"""Generator that yields batches, is sent their results, and returns its result."""


def program_key(name: str, *arguments: Any) -> Hashable:
    """Build a key that identifies a compiled program of a function of this name.

    Arrays among the arguments, which all lanes share, count by shape and type only.
    """
    leaves, tree = jax.tree.flatten(arguments)
    kind = lambda leaf: (leaf.shape, leaf.dtype) if hasattr(leaf, "dtype") else leaf
    return name, tree, tuple(map(kind, leaves))


def usable_cores() -> int:
    """Return the number of cores that this process may use.

    A scheduler may grant fewer than the machine has, and `OMP_NUM_THREADS` limits
    processes that share the machine, like the workers of a sweep.
    """
    n = available_cores()
    told = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    return min(n, int(told)) if told.isdigit() and int(told) else n


class Workers:
    """Context whose threads share the lanes of all running jobs.

    Each thread runs whole lanes on one core, with a sparse solver of its own, because
    threads that share one would overwrite its factors. The result of a lane does not
    depend on the thread. Where several threads of a program open such a context, each
    waits for its turn.

    Attributes:
        n: Number of threads. With one, everything runs in the caller's thread and the
            sparse solver keeps all cores; always one if the solver does not run in
            threads.
    """

    __repr__ = one_line

    def __init__(self, model: Model, lanes: int, n: int | None = None):
        """Prepare copies of the model's sparse solver; see the class.

        Args:
            model: The model.
            lanes: Number of lanes of all jobs, an upper limit of the threads.
            n: Number of threads; by default that of usable cores.

        Raises:
            ValueError: If `n` is less than one, or float64 is off in JAX.
            RuntimeError: If this process was forked from one that had computed.
        """
        check_process()
        if n is not None and n < 1:
            raise ValueError(f"the number of workers must be at least 1, got {n}.")
        self._solver = model.solver
        wanted = usable_cores() if n is None else n
        self.n = max(1, min(wanted, lanes)) if self._solver.runs_in_threads else 1
        self._free: SimpleQueue[AbstractLinearSolver] = SimpleQueue()

    def __enter__(self) -> "Workers":
        with ExitStack() as turn:
            turn.enter_context(_TURN)
            if self.n > 1:
                _forget_as_jax()
                self._pool = ThreadPoolExecutor(self.n)
                with self._solver.on_one_core():
                    for k in range(1, self.n + 1):
                        self._free.put(jax.block_until_ready(self._solver.another(k)))
            self._turn = turn.pop_all()
        return self

    def __exit__(self, *error) -> None:
        if self.n > 1:
            self._pool.shutdown(cancel_futures=True)
        self._turn.close()

    def end_of(self, job: Job[T]) -> T:
        """Run one job and return its result; see `ends`."""
        return self.ends([job])[0]

    def ends(
        self, jobs: Iterable[Job[T]], told: Callable[[int, T], None] | None = None
    ) -> list[T]:
        """Run jobs with their lanes in parallel; return their results in order.

        Lanes of earlier jobs go first, and a new job starts only when the others do not
        fill the threads. Jobs therefore finish one after the other, and few are lost if
        this is interrupted. Between batches a job computes in the caller's thread.
        `told` is called with the index and the result of each job as it ends.
        """
        return _Round(self, list(jobs), told or (lambda *_: None)).ends()

    def submit(self, batch: Batch, lane: int) -> Future:
        """Submit one lane by its index; with a single worker it runs at once."""
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
        """Return the context in which the workers' solvers must run."""
        return self._solver.on_one_core() if self.n > 1 else nullcontext()


class _Round:
    """State of the jobs of one call of `Workers.ends`."""

    def __init__(self, workers: Workers, jobs: list[Job], told):
        self._workers, self._jobs, self._told = workers, jobs, told
        self._ends: list[Any] = [None] * len(jobs)
        self._to_begin = iter(range(len(jobs)))
        self._batches: dict[int, Batch] = {}
        self._found: dict[int, dict[int, Any]] = {}
        self._waiting: list[tuple[int, int]] = []  # a heap of (job, lane)
        self._under_way: dict[Future, tuple[int, int]] = {}
        self._one_core = ExitStack()
        # Two lanes per thread, so that none idles while a job computes its step.
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
        """Submit lanes; return whether any is running."""
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
        """Wait for lanes to end, and send complete batches to their jobs."""
        done, _ = wait(self._under_way, return_when=FIRST_COMPLETED)
        places = {future: self._under_way.pop(future) for future in done}
        if not self._under_way:
            # Between batches the caller may use all cores again.
            self._one_core.close()
        for future, (job, lane) in places.items():
            found = self._found[job]
            found[lane] = future.result()
            if len(found) == len(self._batches[job].lanes):
                self._go_on(job, [found[k] for k in range(len(found))])

    def _go_on(self, job: int, found: list[Any] | None) -> None:
        try:
            # A new generator must be sent None.
            batch = self._jobs[job].send(found)  # pyright: ignore[reportArgumentType]
        except StopIteration as end:
            self._ends[job] = end.value
            self._told(job, end.value)
            return
        jax.block_until_ready(batch.lanes)  # so that no thread waits for them
        self._batches[job], self._found[job] = batch, {}
        for lane in range(len(batch.lanes)):
            heappush(self._waiting, (job, lane))
