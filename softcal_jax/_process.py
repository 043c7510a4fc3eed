"""This process, and the machine and packages on which it runs."""

import os
import platform
import re
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import jax

_first: list[int] = []
"""Id of the process that first computed here; a forked child inherits the list."""


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
    if info.exists():
        match = re.search(r"(?m)^model name\s*: (.+)$", info.read_text())
        if match:
            return match.group(1).strip()
    return platform.processor() or platform.machine()


def installed_version(package: str) -> str:
    """Return the version of a package, or that it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"  # run from a checkout
