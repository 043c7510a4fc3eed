"""Libraries in a process of their own, which damaged files crash, hang or fill.

This file is that process, too: it imports nothing of the package, and so starts in a
fraction of a second.
"""

import pickle
import re
import runpy
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

OUT_OF_MEMORY = re.compile(
    "MemoryError|bad_alloc|alloc failed|out of memory|failed to map segment", re.I
)
"""How programs say that they get no more memory."""


def run_apart(program: Path, given: Any, *, seconds: float, megabytes: float):
    """Return what `main(given)` of a program returns, and what it printed of errors.

    Both are pickled. The folder in which it works is its own.

    Raises:
        subprocess.TimeoutExpired: If it takes longer.
        MemoryError: If it needs more memory than this, or than there is.
        RuntimeError: If it raises an error or crashes; the text says which.
    """
    with tempfile.TemporaryDirectory() as folder:
        given_at, made_at = Path(folder, "given"), Path(folder, "made")
        given_at.write_bytes(pickle.dumps(given))
        options = ["-P", "-W", "ignore", __file__]  # -P: modules beside it shadow none
        done = subprocess.run(
            [sys.executable, *options, program, given_at, made_at, str(megabytes)],
            timeout=min(seconds, threading.TIMEOUT_MAX),
            cwd=folder,
            capture_output=True,
            errors="replace",
        )
        said = done.stderr.strip()
        if done.returncode == 0:
            return pickle.loads(made_at.read_bytes()), said
    # By SIGKILL Linux ends a process when memory runs out.
    if OUT_OF_MEMORY.search(said) or done.returncode == -9:
        raise MemoryError("out of memory")
    if done.returncode < 0:
        raise RuntimeError(f"it crashed ({signal.strsignal(-done.returncode)})")
    raise RuntimeError((said.splitlines() or ["it does not say why"])[-1])


def _limit_memory(megabytes: float) -> None:
    """Let this process take no more memory, where the system can see to it."""
    if sys.platform != "linux" or megabytes == float("inf"):
        return
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = int(1e6 * megabytes)
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))


def _main(program: str, given_at: str, made_at: str, megabytes: str) -> None:
    _limit_memory(float(megabytes))
    try:
        made = runpy.run_path(program)["main"](
            pickle.loads(Path(given_at).read_bytes())
        )
    except Exception as error:  # libraries raise any
        kind = type(error).__name__
        named = f"{kind}: " if kind not in ("Exception", "ValueError") else ""
        sys.exit(" ".join(f"{named}{error}".split()))
    Path(made_at).write_bytes(pickle.dumps(made))


if __name__ == "__main__":
    _main(*sys.argv[1:])
