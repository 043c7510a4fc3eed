"""A line that says what a long call in Python is doing, and for how long."""

import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


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
