"""Output of a command while it works."""

import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console, RenderableType
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn


class Display:
    """Lines for what is done; on a terminal, a spinner for what is under way.

    Attributes:
        laps: Wall time of the parts so far [s].
    """

    def __init__(self, begin: float):
        self.console = Console(file=sys.stdout)
        self.begin = self.last = begin
        self.laps: dict[str, float] = {}
        self.progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            TimeElapsedColumn(),
            console=self.console,
            transient=True,
            disable=not self.console.is_terminal,
        )

    def __enter__(self) -> "Display":
        self.progress.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.progress.stop()

    def now(self, what: str, *, log: bool = True) -> None:
        """Say what begins; in a log, only if `log` is set."""
        if self.progress.disable:
            if log:
                self.line(f"{what} ...")
            return
        for task in self.progress.task_ids:
            self.progress.remove_task(task)
        self.progress.add_task(what, total=None)

    def line(self, text: RenderableType = "") -> None:
        """Print a line that stays."""
        if isinstance(text, str):
            self.console.print(text, markup=False, highlight=False, soft_wrap=True)
        else:
            self.console.print(text)

    def lap(self, name: str) -> None:
        """End a part of the run, and record its wall time."""
        now = time.time()
        self.laps[name] = now - self.last
        self.last = now

    def split(self, name: str, part: str, seconds: float) -> None:
        """Split off a part of a lap, as a lap of its own before it [s]."""
        whole = self.laps.pop(name)
        self.laps |= {part: seconds, name: whole - seconds}

    def total(self) -> float:
        """Return the wall time since the process began [s]."""
        return time.time() - self.begin


@contextmanager
def warnings_as_lines(show: Display) -> Iterator[None]:
    """Show the package's own warnings as lines, without file and line of code."""
    from softcal_jax._compilation_cache import (
        CompilationCacheWarning,
        throw_away_damaged,
    )
    from softcal_jax.calibration import CalibrationWarning
    from softcal_jax.configurations import TrackerWarning
    from softcal_jax.mesh import MeshWarning
    from softcal_jax.report import PictureWarning

    own = (
        CalibrationWarning,
        CompilationCacheWarning,
        MeshWarning,
        PictureWarning,
        TrackerWarning,
    )
    with warnings.catch_warnings():
        plain = warnings.showwarning

        def line(message, category, *where, **more):
            mended = throw_away_damaged(str(message))
            if issubclass(category, own) or mended:
                show.line(f"warning: {mended or message}")
            else:
                plain(message, category, *where, **more)

        warnings.showwarning = line
        for category in own:
            warnings.simplefilter("always", category)
        yield


def process_start() -> float:
    """Estimate when this program began [s since 1970]: now minus its CPU time.

    The start of the process will not do: a shell may have run in it before.
    """
    return time.time() - time.process_time()
