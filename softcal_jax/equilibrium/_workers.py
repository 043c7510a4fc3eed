"""Lanes side by side: programs in threads, or a device of JAX for each core."""

import os
import threading
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import (
    FIRST_EXCEPTION,
    CancelledError,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from queue import SimpleQueue
from threading import Event, Lock, RLock
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, PartitionSpec

from softcal_jax._process import available_cores, check_process
from softcal_jax._typing import is_traced
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
    """Do nothing; `jax.clear_caches` forgets this program like all others."""


class Program:
    """A compiled function of shared arguments and of a lane; lanes have one shape.

    One thread compiles it, while the others wait. Each thread replaces the sparse
    solvers in the shared arguments by its own.
    """

    def __init__(self, function: Any, *shared: Any):
        self._function, self._shared = function, shared
        self._key: Hashable = None
        self._on: dict[int, tuple[AbstractLinearSolver, Any]] = {}

    def run(self, solver: AbstractLinearSolver, lane: Sequence[Any]) -> Any:
        with self._first(lane) as first:
            if first:
                return self._result(solver, lane)
        return self._result(solver, lane)

    def compile(self, lane: Sequence[Any]) -> None:
        """Compile the program for lanes like this one, unless that is done."""
        with self._first(lane) as first:
            if first:
                self._function.lower(*self._shared, *lane).compile()

    @contextmanager
    def _first(self, lane: Sequence[Any]) -> Iterator[bool]:
        """Wait for a thread that compiles the program; yield whether this has to."""
        if self._key is None:
            self._key = _key(self._function, self._shared, lane)
        if self._key in _COMPILED:
            yield False
            return
        with _COMPILING.setdefault(self._key, Lock()):
            first = self._key not in _COMPILED
            yield first
            if first:
                _COMPILED.add(self._key)

    def _result(self, solver: AbstractLinearSolver, lane: Sequence[Any]) -> Any:
        # Keep the solver too, so that its id is not given to another one.
        if id(solver) not in self._on:
            is_solver = lambda node: isinstance(node, AbstractLinearSolver)
            replaced = lambda node: solver if is_solver(node) else node
            shared = jax.tree.map(replaced, self._shared, is_leaf=is_solver)
            self._on[id(solver)] = solver, shared
        return jax.block_until_ready(self._function(*self._on[id(solver)][1], *lane))


def _key(function: Callable, shared: Any, lane: Any) -> Hashable:
    """Identify the compiled program: arrays count by shape and type only."""
    leaves, tree = jax.tree.flatten((shared, lane))
    kind = lambda leaf: (leaf.shape, leaf.dtype) if hasattr(leaf, "dtype") else leaf
    return function.__module__, function.__qualname__, tree, tuple(map(kind, leaves))


def usable_cores() -> int:
    """Return the number of cores that this process may use.

    `OMP_NUM_THREADS` limits processes that share the machine, like those of a sweep.
    """
    n = available_cores()
    limit = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    return min(n, int(limit)) if limit.isdigit() and int(limit) else n


class _SideBySide(NamedTuple):
    """Lock and stop flag of the threads of one call of `Workers.side_by_side`.

    Only the thread that holds `thinks` computes between lanes, so that data of all runs
    need no locks and a program is compiled once. `stopped` is set when results are no
    longer wanted; `outer` belongs to the call around this one, if there is one.
    """

    thinks: Lock
    stopped: Event
    outer: "_SideBySide | None"

    def check(self) -> None:
        if self.stopped.is_set():
            raise CancelledError
        if self.outer is not None:
            self.outer.check()


class _Thread(threading.local):
    run: _SideBySide | None = None


_THREAD = _Thread()


@contextmanager
def _lets_others_think() -> Iterator[None]:
    """Let other runs compute while this thread waits, if it belongs to a run."""
    run = _THREAD.run
    if run is None:
        yield
        return
    run.thinks.release()
    try:
        yield
    finally:
        run.thinks.acquire()


def _join(futures: Sequence[Future]) -> None:
    """Cancel what has not begun, and wait for the rest even if interrupted."""
    for future in futures:
        future.cancel()
    try:
        wait(futures)
    except KeyboardInterrupt:
        _join(futures)
        raise


class Workers:
    """Context whose threads run lanes of compiled programs side by side.

    Each thread runs whole lanes, with a sparse solver of its own, because threads that
    share one would overwrite its factors. The result of a lane does not depend on the
    thread. Threads of a program that open such a context wait for their turn.

    Attributes:
        n: Number of threads. With one, everything runs in the caller's thread and the
            sparse solver keeps all cores; always one if the solver does not run in
            threads.
    """

    def __init__(self, model: Model, lanes: int, n: int | None = None):
        """Prepare `n` threads, by default one per usable core, and at most `lanes`.

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
        if _remembered._cache_size() == 0:  # pyright: ignore[reportAttributeAccessIssue]
            _COMPILED.clear()
            _remembered()
        with ExitStack() as opened:
            if _THREAD.run is None:
                opened.enter_context(_TURN)
            self._ahead = ThreadPoolExecutor(1)
            opened.callback(self._ahead.shutdown, wait=False, cancel_futures=True)
            if self.n == 1:
                self._free.put(self._solver)
            else:
                self._pool = opened.enter_context(ThreadPoolExecutor(self.n))
                with self._solver.side_by_side():
                    for k in range(1, self.n + 1):
                        self._free.put(jax.block_until_ready(self._solver.another(k)))
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *error) -> None:
        self._opened.close()

    def ahead(self, program: Callable[[], tuple[Program, Sequence[Any]]]) -> None:
        """Compile a program for lanes like the first in the background, for later use.

        An error is not raised here; the program fails again when it is used.
        """

        def compile_first() -> None:
            due, lanes = program()
            for lane in lanes[:1]:
                due.compile(lane)

        if usable_cores() > 1:
            self._ahead.submit(compile_first)

    def check(self) -> None:
        """Raise CancelledError in a run whose result is no longer wanted."""
        if _THREAD.run is not None:
            _THREAD.run.check()

    def map(self, program: Program, lanes: Iterable[Sequence[Any]]) -> list[Any]:
        """Run all lanes of a program and return their results in order."""
        lanes, run = list(lanes), _THREAD.run
        jax.block_until_ready(lanes)  # so that no thread waits for them

        def one(lane: Sequence[Any]) -> Any:
            if run is not None:
                run.check()
            solver = self._free.get()
            try:
                return program.run(solver, lane)
            finally:
                self._free.put(solver)

        if self.n == 1:
            return list(map(one, lanes))
        futures: list[Future] = []
        with self._solver.side_by_side(), _lets_others_think():
            try:
                for lane in lanes:
                    futures.append(self._pool.submit(one, lane))
                wait(futures, return_when=FIRST_EXCEPTION)
            finally:
                _join(futures)
        # Lanes begin in order, so several workers raise the same error as one.
        return [future.result() for future in futures]

    def side_by_side(
        self,
        runs: Iterable[Callable[[], T]],
        ended: Callable[[int, T], None] = lambda *_: None,
    ) -> list[T]:
        """Call functions that use `map`, side by side; return their results in order.

        They begin in order, and few are under way at once: little is lost if this is
        interrupted. Between their lanes they compute one at a time. If several raise,
        the error is that of the first in order. `ended` is called in the same order, in
        the caller's thread, with index and result.
        """
        results: list[T] = []

        def keep(result: T) -> None:
            results.append(result)
            ended(len(results) - 1, result)

        if self.n == 1:
            for call in runs:
                keep(call())
            return results
        outer, stopped = _THREAD.run, Event()
        run = _SideBySide(Lock() if outer is None else outer.thinks, stopped, outer)

        def one(call: Callable[[], T]) -> T:
            with run.thinks:
                run.check()
                return call()

        futures: list[Future] = []
        # One more than lanes can run, so that none idles while a run computes its step.
        begin = partial(setattr, _THREAD, "run", run)
        pool = ThreadPoolExecutor(self.n + 1, initializer=begin)
        with self._solver.side_by_side(), _lets_others_think(), pool:
            try:
                for call in runs:
                    futures.append(pool.submit(one, call))
                for future in futures:
                    keep(future.result())
            finally:
                stopped.set()
                _join(futures)
        return results


def use_cores(n: int | None = None) -> int:
    """Let `map_lanes` solve lanes on several cores at a time.

    Programs call it before JAX computes anything; libraries do not. Each core becomes a
    device of JAX, with a sparse solver of one thread; all else runs on the first.

    Args:
        n: Number of cores, which is returned; by default all that may be used.

    Raises:
        ValueError: If `n` is less than one.
        RuntimeError: If JAX has computed already, with another number of devices.
    """
    n = usable_cores() if n is None else n
    if n < 1:
        raise ValueError(f"the number of cores must be at least 1, got {n}.")
    try:
        jax.config.update("jax_num_cpu_devices", n)
    except RuntimeError:
        if (before := jax.local_device_count("cpu")) != n:  # equal in a cell run twice
            raise RuntimeError(
                f"use_cores({n}) came too late: JAX has computed already (CPU devices: "
                f"{before}). Call it first; in a notebook, restart the kernel before."
            ) from None
    return n


def map_lanes(
    function: Callable[..., Any], model: Model, lanes: Any, *others: Any
) -> Any:
    """Apply a function to all lanes of a batch, on the cores of `use_cores`.

    On one core this is `jax.vmap(lambda lane: function(model, lane, *others))(lanes)`.
    On several, each has a `vmap` over its share and a sparse solver of its own; only
    rounding may differ. Under `jit` and autodiff the results lie on all devices, where
    the next program runs too, until `jax.device_get` takes them from there. Pass what
    changes as an argument: each function and set of shapes compiles once.

    Args:
        function: Takes the model, one lane and the others; returns arrays.
        model: The model.
        lanes: Arrays with a leading axis, like `lanes(model, poses)`, moduli, or both.
        *others: What all lanes share; numbers are traced, but for int and bool.

    Returns:
        What the function returns, with a leading axis.

    Raises:
        ValueError: If there is no lane, or arrays differ in their number.
    """
    n = {(*jnp.shape(leaf), 0)[0] for leaf in jax.tree.leaves(lanes)}
    if len(n) != 1 or 0 in n:
        raise ValueError(f"expected as many lanes in all arrays, 1 or more, got {n}.")
    # Programs that call the solver back on the host deadlock side by side.
    if jax.local_device_count() == 1 or not model.solver.runs_in_threads:
        return jax.vmap(lambda lane: function(model, lane, *others))(lanes)
    as_array = lambda leaf: jnp.asarray(leaf) if isinstance(leaf, float) else leaf
    results = _on_devices(function, model, lanes, jax.tree.map(as_array, others))
    traced = any(map(is_traced, jax.tree.leaves(results)))
    return results if traced else jax.device_put(jax.device_get(results))


@eqx.filter_jit
def _on_devices(function, model, lanes, others):
    n, n_devices = len(jax.tree.leaves(lanes)[0]), jax.local_device_count()
    each = -(-n // n_devices)
    n_used = -(-n // each)  # the others would only repeat lanes
    # In turn, since neighbours often cost the same; the rest repeats the first lane.
    place = np.arange(n) % n_used * each + np.arange(n) // n_used
    lane_at = np.zeros(n_devices * each, int)
    lane_at[place] = np.arange(n)
    arrays, rest = eqx.partition((model, others), eqx.is_array)

    def share(arrays, lanes):
        (model, others), device = eqx.combine(arrays, rest), jax.lax.axis_index("lanes")
        model = replace(model, solver=model.solver.on_device(device))
        solved = lambda: jax.vmap(lambda lane: function(model, lane, *others))(lanes)
        zeros = lambda: jax.tree.map(jnp.zeros_like, jax.eval_shape(solved))
        return jax.lax.cond(device < n_used, solved, zeros)

    on_devices = jax.shard_map(
        share,
        mesh=jax.make_mesh((n_devices,), ("lanes",), (AxisType.Auto,)),
        in_specs=(PartitionSpec(), PartitionSpec("lanes")),
        out_specs=PartitionSpec("lanes"),
        check_vma=False,
    )
    taken = jax.tree.map(lambda leaf: jnp.asarray(leaf)[lane_at], lanes)
    return jax.tree.map(lambda leaf: leaf[place], on_devices(arrays, taken))
