"""The JSON record of a run: figures, samples, and what they were measured on."""

import json
import os
import platform
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from benchmarks._problem import Outcome
from softcal_jax._process import available_cores, cpu_name, installed_version

_PACKAGES = (
    "jax",
    "jaxlib",
    "equinox",
    "jaxopt",
    "optimistix",
    "numpy",
    "scipy",
    "pardiso-mkl-jax",
    "klujax",
    "mkl",
    "felupe",
    "pypardiso",
)


def record(name: str, outcome: Outcome, load_before: float | None) -> dict[str, Any]:
    """The content of the JSON file.

    Args:
        name: Name of the problem.
        outcome: What it found.
        load_before: Load of the machine before the run, `load_average()`.

    Returns:
        `name`, `hardware`, `versions`, `figures`, `better`, `goals` and `samples`.
    """
    return {
        "name": name,
        "hardware": {**hardware(), "load_before": load_before},
        "versions": versions(),
        "figures": dict(outcome.figures),
        "better": {figure: outcome.better_of(figure) for figure in outcome.figures},
        "goals": {
            figure: {"goal": str(goal), "met": goal.met(outcome.figures[figure])}
            for figure, goal in outcome.goals.items()
        },
        "samples": {key: list(values) for key, values in outcome.samples.items()},
    }


def renewed(
    old: dict[str, Any], new: dict[str, Any], parts: Iterable[str]
) -> dict[str, Any]:
    """Put the figures of some parts into an earlier record of the same benchmark.

    Args:
        old: The record of all parts.
        new: The record of these parts.
        parts: Their names.

    Returns:
        The old record with the new figures, and under `renewed` the machine and the
        versions of each part that was run anew.

    Raises:
        ValueError: If they are of different benchmarks.
    """
    if old["name"] != new["name"]:
        raise ValueError(
            f"the record is of {old['name']!r}, but the run of {new['name']!r}."
        )
    both = {
        key: old[key] | new[key] for key in ("figures", "better", "goals", "samples")
    }
    source = {key: new[key] for key in ("hardware", "versions")}
    return (
        old | both | {"renewed": old.get("renewed", {}) | dict.fromkeys(parts, source)}
    )


def hardware() -> dict[str, Any]:
    """The machine: processor, cores, memory [GB], operating system."""
    return {
        "cpu": cpu_name(),
        "cores": available_cores(),
        "memory_gb": _memory_gb(),
        "os": platform.platform(),
    }


def load_average() -> float | None:
    """Processes that wanted a core during the last minute; None if it is not known.

    Timings taken while others compute are worth little, and the record should tell.
    """
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def versions() -> dict[str, str]:
    """Versions of Python, this package and its commit, and all that computes."""
    return {
        "python": platform.python_version(),
        "softcal_jax": installed_version("softcal-jax"),
        "commit": _commit(),
        **{package: installed_version(package) for package in _PACKAGES},
    }


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a file whole or not at all.

    Args:
        path: The file; replaced if it exists.
        content: What goes in; NaN and infinity are refused.

    Raises:
        ValueError: If a number is not finite.
    """
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    handle, partial = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        # mkstemp keeps the file to its owner; a result is for everyone.
        os.chmod(partial, 0o644)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(partial, path)
    except BaseException:
        Path(partial).unlink(missing_ok=True)
        raise


def _memory_gb() -> float | None:
    try:
        size = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None  # Windows has no sysconf
    return round(size / 1e9, 1)


def _commit() -> str:
    def git(*words: str) -> str:
        done = subprocess.run(
            ["git", "-C", str(Path(__file__).parent), *words],
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no")
        return git("rev-parse", "--short", "HEAD") + ("-changed" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"  # run from outside a checkout
