"""Repeats, medians, and times of fresh processes."""

import os
import statistics
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]


def interleave(
    functions: Mapping[str, Callable[[], object]], repeats: int
) -> dict[str, list[float]]:
    """Times of several functions whose repeats take turns [s].

    A machine that slows down in the middle then slows all of them, and ratios hold.
    Before each timed call stands one of the same function that is not timed: it
    compiles, fills the caches, and lets the threads of the previous function (OpenMP
    keeps them spinning for 200 ms) go to sleep or find work.

    Args:
        functions: What is timed, by name; each must wait for its own result.
        repeats: Timed calls of each.

    Returns:
        Wall times by name.
    """
    seconds: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(repeats):
        for name, function in functions.items():
            function()
            begin = time.perf_counter()
            function()
            seconds[name].append(time.perf_counter() - begin)
    return seconds


def forget_starts() -> None:
    """Let the next calibration solve its start, as that of a new robot does."""
    from softcal_jax.calibration._evaluation import _FROM_REST

    _FROM_REST.clear()


def median_ms(seconds: Sequence[float]) -> float:
    """Median [ms] of times [s]."""
    return 1e3 * statistics.median(seconds)


def ratio(peer: Sequence[float], ours: Sequence[float]) -> float:
    """Median of the peer over our median."""
    return statistics.median(peer) / statistics.median(ours)


def run_process(
    command: Sequence[str],
    environment: Mapping[str, str] | None = None,
    folder: Path = ROOT,
) -> str:
    """Standard output of a command that runs in a process of its own.

    Args:
        command: Program and arguments.
        environment: Variables that are added to those of this process.
        folder: Where it runs.

    Raises:
        RuntimeError: If it fails; the text is its error output.
    """
    done = subprocess.run(
        list(command),
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, **(environment or {})},
    )
    if done.returncode:
        raise RuntimeError(
            f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr.strip()}"
        )
    return done.stdout


def at_home(home: str, folder: Path = ROOT) -> dict[str, str]:
    """Environment of a tree, with nothing kept but what is in a folder."""
    return {
        "PYTHONPATH": str(folder),
        "XDG_CACHE_HOME": home,
        "MPLCONFIGDIR": home,  # matplotlib lists the fonts once, which takes a second
        "JAX_ENABLE_COMPILATION_CACHE": "true",
        "JAX_COMPILATION_CACHE_DIR": str(Path(home) / "jax"),
    }
