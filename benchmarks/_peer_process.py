"""A peer in a process of its own.

torch and our PARDISO, loaded into one process, share an OpenMP that one of them sets up
for the other: our solves then fail or crash. What is asked of a peer travels as a
function of it; its time contains the way there and back, 0.2 ms or so.
"""

import multiprocessing
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from typing import Concatenate, ParamSpec, Self, TypeVar

import jax

from benchmarks._peer import AbstractPeer
from benchmarks._peer_job import Job, peer_job

P = ParamSpec("P")
T = TypeVar("T")

_TRIALS = 3
_peers: list[AbstractPeer] = []
"""The peer of this process, once it is open."""


class PeerProcess:
    """A process with one peer; a context, at whose end the process ends."""

    def __init__(self):
        """Start nothing yet."""
        spawn = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, mp_context=spawn, initializer=_in_float64)

    def open(self, module: str) -> str:
        """Set up the job in the library, in the way that is quickest.

        Args:
            module: Module with `variants`, the ways in which it can do the job.

        Returns:
            How the library solves it.

        Raises:
            ModuleNotFoundError: If the library is not installed.
        """
        return self._pool.submit(_open, module).result()

    def ask(
        self,
        question: Callable[Concatenate[AbstractPeer, P], T],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> T:
        """What a function of this project finds with the peer.

        Args:
            question: The function; its first argument is the peer.
            args: Its other arguments.
            kwargs: Its other arguments.
        """
        return self._pool.submit(_ask, question, *args, **kwargs).result()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_) -> None:
        self._pool.shutdown()


def _in_float64() -> None:
    jax.config.update("jax_enable_x64", True)


def _open(module: str) -> str:
    # Our solver has done its part in the job before the library is imported.
    job = peer_job()
    peer = quickest(import_module(f"benchmarks.{module}").variants(job), job)
    _peers.append(peer)
    return peer.label


def _ask(question, *args, **kwargs):
    (peer,) = _peers
    return question(peer, *args, **kwargs)


def quickest(ways: Sequence[Callable[[], AbstractPeer]], job: Job) -> AbstractPeer:
    """The way whose static solve of the first pose is quickest.

    Args:
        ways: What sets up the library for the job.
        job: The job.
    """
    fields = job.fields(job.target)
    best: tuple[float, AbstractPeer] | None = None
    for way in ways:
        peer = way()
        seconds = []
        for _ in range(_TRIALS):  # the first compiles
            begin = time.perf_counter()
            peer.solve(0, fields)
            seconds.append(time.perf_counter() - begin)
        if best is None or min(seconds) < best[0]:
            best = min(seconds), peer
    assert best is not None
    return best[1]
