"""The machine that this process runs on, and the packages on it."""

import os
import platform
import re
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


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
