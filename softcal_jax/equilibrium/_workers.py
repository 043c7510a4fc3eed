"""Compiled programs side by side, one on each core of this machine."""

import os
from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any, TypeVar

import jax

from softcal_jax._machine import available_cores
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver
from softcal_jax.equilibrium._model import Model

A = TypeVar("A")
B = TypeVar("B")

_COMPILED: set[Hashable] = set()
"""Programs that have run in this process."""


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
    """Context with threads that run the lanes of a batch side by side.

    Inside one program XLA runs the loops of the lanes one after the other, and the
    factorization of a small matrix hardly gains from a second core. So each thread
    takes whole lanes, on one core, with a sparse solver of its own: two threads on the
    factors of one would overwrite each other's. Which thread takes a lane changes
    nothing in its result.

    Attributes:
        n: Number of threads; with one, everything runs in the thread of the caller,
            and the sparse solver keeps all cores. It is one where the solver does not
            run in threads.
    """

    def __init__(self, model: Model, lanes: int, n: int | None = None):
        """Threads for a batch.

        Args:
            model: The body, whose sparse solver they need.
            lanes: Lanes of the batch; there are no more threads than these.
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

    def map(
        self,
        function: Callable[[AbstractLinearSolver, A], B],
        lanes: Iterable[A],
        program: Hashable,
    ) -> list[B]:
        """Results of a function of (solver, lane), in the order of the lanes.

        Args:
            function: Runs a compiled program with that solver and waits for its end.
            lanes: What it is called with.
            program: Key of the program, see `program_key`: the first lane of a new one
                goes ahead alone, so that one thread compiles it and not all.
        """
        lanes = list(lanes)
        jax.block_until_ready(lanes)  # nothing else is under way
        if self.n == 1:
            return [function(self._solver, lane) for lane in lanes]

        def run(lane: A) -> B:
            solver = self._free.get()
            try:
                return function(solver, lane)
            finally:
                self._free.put(solver)

        first: list[B] = []
        with self._solver.on_one_core():
            if program not in _COMPILED:
                first = [run(lane) for lane in lanes[:1]]
                _COMPILED.add(program)
            return [*first, *self._pool.map(run, lanes[len(first) :])]
