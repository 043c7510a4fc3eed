"""Libraries in a process of their own, which damaged files crash, hang or fill.

This file is that process, too: there it imports nothing of the package, and so starts
in a fraction of a second.
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

_OUT_OF_MEMORY = re.compile(
    "MemoryError|bad_alloc|alloc failed|out of memory|failed to map segment", re.I
)
"""How programs say that they get no more memory."""

_KEPT = (ImportError, MemoryError, OverflowError, ValueError)  # errors raised as such


def run_apart(program: Path, given: Any) -> tuple[Any, str]:
    """Return what `main(given)` of a program returns, and what it printed of errors.

    The folder in which it works is its own.

    Raises:
        TimeoutError: If it takes longer than SOFTCAL_MAX_MESHING_S.
        MemoryError: If it needs more than SOFTCAL_MAX_MESHING_MB, or than there is.
        RuntimeError: If it crashes, or raises anything but a few errors of Python.
    """
    from softcal_jax._places import MESHING_MEGABYTES, MESHING_SECONDS

    seconds, megabytes = MESHING_SECONDS.most, MESHING_MEGABYTES.most
    with tempfile.TemporaryDirectory() as folder:
        given_at, made_at = Path(folder, "given"), Path(folder, "made")
        given_at.write_bytes(pickle.dumps(given))
        options = ["-P", "-W", "ignore", __file__]  # -P: modules beside it shadow none
        try:
            done = subprocess.run(
                [sys.executable, *options, program, given_at, made_at, str(megabytes)],
                timeout=min(seconds, threading.TIMEOUT_MAX),
                cwd=folder,
                capture_output=True,
                errors="replace",
            )
        except subprocess.TimeoutExpired as error:
            raise TimeoutError(f"it takes longer than {seconds:g} s") from error
        said, code = done.stderr.strip(), done.returncode
        if code:
            last = (said.splitlines() or ["it does not say why"])[-1]
            crash = f"it crashed ({signal.strsignal(-code)})" if code < 0 else last
            made: Any = RuntimeError(crash)
        else:
            made = pickle.loads(made_at.read_bytes())
    if not isinstance(made, Exception):
        return made, said
    # By SIGKILL Linux ends a process when memory runs out.
    if code == -9 or _OUT_OF_MEMORY.search(f"{made!r} {said}"):
        raise MemoryError(f"it needs more than {megabytes:g} MB of memory") from made
    raise made


def _main(program: str, given_at: str, made_at: str, megabytes: str) -> None:
    if sys.platform == "linux" and megabytes != "inf":
        import resource

        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        most = int(1e6 * float(megabytes))
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    try:
        given = pickle.loads(Path(given_at).read_bytes())
        made = runpy.run_path(program)["main"](given)
    except Exception as error:  # libraries raise any
        kind = type(error).__name__
        named = "" if kind in ("Exception", "RuntimeError") else f"{kind}: "
        text = " ".join(f"{named}{error}".split())
        made = error if type(error) in _KEPT else RuntimeError(text)
    Path(made_at).write_bytes(pickle.dumps(made))


if __name__ == "__main__":
    _main(*sys.argv[1:])
