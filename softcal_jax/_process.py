"""This process: what it must be like, its clock and machine, and what it is doing."""

import os
import platform
import re
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import jax

HALF_A_DAY_S = 12 * 3600.0  # from here on the end of what is under way has a date [s]
_first: list[int] = []  # id of the process that first computed; a forked child has it


def check_process() -> None:
    """Raise unless JAX can compute here, and in float64.

    In float32 equilibria do not converge. A child that was forked lacks the threads
    of JAX and of the sparse solver: a computation would wait for them for ever.
    """
    if not jax.config.read("jax_enable_x64"):
        raise ValueError(
            "softcal_jax needs float64, but JAX is in float32. Put "
            '`jax.config.update("jax_enable_x64", True)` at the top of your program, '
            "or set JAX_ENABLE_X64=1."
        )
    pid = os.getpid()
    if not _first:
        _first.append(pid)
    if _first[0] != pid:
        raise RuntimeError(
            f"this process ({pid}) was forked from one in which softcal_jax had "
            f"computed ({_first[0]}), whose threads it lacks. Start processes with "
            '`multiprocessing.get_context("spawn")`, which a ProcessPoolExecutor takes '
            'as `mp_context`, or with joblib\'s "loky".'
        )


def available_cores() -> int:
    """Count the cores that this process may use, which a scheduler may limit."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def cpu_name() -> str:
    """Name the model of the processor."""
    info = Path("/proc/cpuinfo")  # Linux; elsewhere `platform` knows
    text = info.read_text() if info.exists() else ""
    match = re.search(r"(?m)^model name\s*: (.+)$", text)
    return match[1].strip() if match else platform.processor() or platform.machine()


def installed_version(package: str) -> str:
    """Return the version of a package, or that it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"  # run from a checkout


def ends_at(seconds: float) -> str:
    """Say when what takes so long from now will end, which stays true meanwhile."""
    end = datetime.now() + timedelta(seconds=seconds)
    return f"ends about {end:{'%H:%M' if seconds < HALF_A_DAY_S else '%d %b, %H:%M'}}"


class Clock:
    """Context whose `seconds` are its wall time, "compile" by JAX and "solve" [s].

    JAX reports the duration of each trace, lowering and compilation when it ends. Those
    that overlap are counted once, as "compile" even where a solve runs beside them.
    """

    def __init__(self):
        self._compiling: list[tuple[float, float]] = []
        self._end: float | None = None

    def __enter__(self) -> "Clock":
        self._begin = time.perf_counter()
        jax.monitoring.register_event_duration_secs_listener(self._listen)
        return self

    def __exit__(self, *_) -> None:
        jax.monitoring.unregister_event_duration_listener(self._listen)
        self._end = time.perf_counter()

    @property
    def seconds(self) -> dict[str, float]:
        """Wall time so far, or at the end of the context [s]."""
        elapsed = (self._end or time.perf_counter()) - self._begin
        compiling, reached = 0.0, self._begin
        for begin, end in sorted(self._compiling):
            compiling += max(0.0, end - max(begin, reached))
            reached = max(reached, end)
        return {"compile": compiling, "solve": elapsed - compiling}

    def _listen(self, event: str, duration_secs: float, **_) -> None:
        if event.startswith("/jax/core/compile/"):
            now = time.perf_counter()
            self._compiling.append((now - duration_secs, now))


@contextmanager
def progress_line(*, wanted: bool) -> Iterator[Callable[[object], None] | None]:
    """Show what was said last, and the time so far, until the end of the context.

    Yields a function that says it; None unless it is `wanted` on a terminal or in a
    notebook.
    """
    handle, ipython = None, sys.modules.get("IPython")
    if wanted and ipython is not None and hasattr(ipython.get_ipython(), "kernel"):
        handle = ipython.display.DisplayHandle()
        handle.display({"text/plain": ""}, raw=True)
    if not wanted or (handle is None and not sys.stderr.isatty()):
        yield None
        return
    begin, over, said = time.monotonic(), threading.Event(), ["starting"]

    def write(text: str) -> None:
        if handle is not None:
            return handle.update({"text/plain": text}, raw=True)
        room = shutil.get_terminal_size().columns - 1
        print(f"\r{text[:room]:<{room}}", end="\r", file=sys.stderr, flush=True)

    def beat() -> None:
        while not over.wait(0.5):
            write(f"{time.monotonic() - begin:.0f} s: {said[0]}".partition("\n")[0])

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield lambda what: said.__setitem__(0, str(what))
    finally:
        over.set()
        thread.join()
        write("")
