"""What a command says while it runs: lines, what is under way, and JSON."""

import argparse
import io
import json
import logging
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from datetime import timedelta
from functools import partial
from textwrap import fill
from typing import Any, NoReturn

from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.progress import BarColumn, Progress, ProgressColumn, Task
from rich.segment import Segment
from rich.text import Text

from softcal_jax._text import escaped

SILENCE_S = 4.0  # after which a log says what is under way [s]

_COMPILE = "/jax/core/compile/"
_BACKEND = f"{_COMPILE}backend_compile_duration"
_FROM_DISK = "/jax/compilation_cache/cache_hits"

NOTICED_S = 0.5  # time of compiling after which it is mentioned [s]


class PlainConsole(Console):
    """A console that shows control characters in a text, where others obey them."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Render as `Console` does, with the control characters of texts escaped."""
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                yield Segment(escaped(segment.text), segment.style)


class HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Wraps a text of one line, and leaves one of several lines as it is."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        text = text if "\n" in text else fill(text, width)
        return super()._fill_text(text, width, indent)


class PlainParser(argparse.ArgumentParser):
    """A parser that quotes wrong arguments without their control characters."""

    def __init__(self, *name: Any, **options: Any):
        lines = partial(HelpFormatter, max_help_position=26)
        super().__init__(*name, formatter_class=lines, **options)

    def error(self, message: str) -> NoReturn:
        super().error(escaped(message))


def escape_what_cannot_be_encoded() -> None:
    """Let standard output and error show characters that their encoding lacks.

    The encoding of the locale C, or of a pipe on Windows, may have no "±" or "ö": a
    command would then end in a traceback once its work is done.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


class Compiling:
    """Listener of JAX: what is being compiled, from its beginning on.

    JAX reports the start of each trace, lowering and compilation as a scalar, and the
    end as a duration. Programs are compiled by several threads at once.
    """

    def __init__(self):
        self._lock = threading.Lock()
        self._open: Counter[tuple[int, str]] = Counter()
        self._since = self._before = 0.0
        self._kept = True
        self._listening = False

    def start(self) -> None:
        """Listen to JAX, once it is imported and its cache is chosen."""
        import jax

        self._kept = bool(
            jax.config.values["jax_enable_compilation_cache"]
            and jax.config.values["jax_compilation_cache_dir"]
        )
        if not self._listening:
            self._listening = True
            jax.monitoring.register_scalar_listener(self._begins)
            jax.monitoring.register_event_duration_secs_listener(self._ends)
            jax.monitoring.register_event_listener(self._ends)

    def stop(self) -> None:
        if self._listening:
            import jax

            self._listening = False
            jax.monitoring.unregister_scalar_listener(self._begins)
            jax.monitoring.unregister_event_duration_listener(self._ends)
            jax.monitoring.unregister_event_listener(self._ends)

    def words(self) -> str:
        """Say what is being compiled, and the time of all compiling so far.

        Empty where nothing is being compiled, or not for long yet.
        """
        now = time.time()
        with self._lock:
            if not self._open or now - self._since < NOTICED_S:
                return ""
            compiles = any(event == _BACKEND for _, event in self._open)
            seconds = self._before + now - self._since
        only = " (first run only)" if self._kept else ""
        what = f"compiling{only}" if compiles else "preparing a program"
        return f"{what}, {seconds:.0f} s"

    def _begins(self, event: str, value: float, **_: Any) -> None:
        if event.startswith(_COMPILE):
            with self._lock:
                if not self._open:
                    self._since = time.time()
                self._open[threading.get_ident(), event] += 1

    def _ends(self, event: str, *_: float, **__: Any) -> None:
        """Record an end; reading a program from disk ends its compilation, too."""
        key = threading.get_ident(), _BACKEND if event == _FROM_DISK else event
        with self._lock:
            if key not in self._open:
                return
            self._open[key] -= 1
            if not self._open[key]:
                del self._open[key]
            if not self._open:  # threads that compile at once count once
                self._before += time.time() - self._since


class Display:
    """Lines for what is done; on a terminal, a moving line for what is under way.

    In a log (a file, a pipe) that line becomes a plain one after some silence. All go
    to standard output; with `as_json` to standard error, and standard output holds
    JSON alone. The command began at `begin`, as of `time.time` [s]; `laps` are the wall
    times of its parts so far [s].
    """

    def __init__(self, begin: float, *, quiet: bool = False, as_json: bool = False):
        self._out = sys.stdout
        file = sys.stderr if as_json else sys.stdout
        self.console = PlainConsole(file=file)
        self.quiet, self.as_json = quiet, as_json
        self.begin = self.last = begin
        self.laps: dict[str, float] = {}
        self.warnings: list[str] = []
        self.compiling = Compiling()
        # A console takes a file for a terminal where FORCE_COLOR is set.
        self._moves = self.console.is_interactive and file.isatty() and not quiet
        self.progress = Progress(
            BarColumn(bar_width=30),
            _UnderWay(self.compiling, begin),
            console=self.console,
            transient=True,
            disable=not self._moves,
            redirect_stdout=not as_json,
        )
        self._task = self.progress.add_task("", total=None)
        self._what, self._said, self._printed = "", time.monotonic(), False
        self._over = threading.Event()
        self._beats = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> "Display":
        self.progress.start()
        if not self._moves and not self.quiet:
            self._beats.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self.progress.stop()
        self.compiling.stop()
        if self._beats.is_alive():
            self._beats.join()

    def now(
        self, what: str, *, log: bool = True, count: tuple[int, int] | None = None
    ) -> None:
        """Say what begins; in a log at once if `log` is set, else after some silence.

        `count` is how many parts are done and how many there are, for a bar.
        """
        done, total = count or (0, None)
        self._what = f"{what} ({done} of {total})" if count else what
        self.progress.reset(
            self._task, description=what, completed=done, total=total, start=True
        )
        if log and not self._moves:
            self.note(f"{what} ...")

    def note(self, text: RenderableType = "") -> None:
        """Print a line on what is read or done, which `quiet` leaves out."""
        if not self.quiet:
            self.line(text)

    def line(self, text: RenderableType = "") -> None:
        self._said = time.monotonic()
        for part in text.renderables if isinstance(text, Group) else [text]:
            soft = isinstance(part, str | Text)  # a terminal wraps it, a log does not
            self.console.print(part, markup=False, highlight=False, soft_wrap=soft)

    def warning(self, text: str) -> None:
        self.warnings.append(text)
        self.line(f"warning: {text}")

    def document(self, content: Mapping[str, Any], *, indent: int | None = 2) -> None:
        """Print a result as JSON if that is asked for, in one line without `indent`."""
        if self.as_json:
            self._printed = True
            text = json.dumps(content, allow_nan=False, indent=indent)
            print(text, file=self._out, flush=True)

    def failure(self, text: str, code: int) -> None:
        """Say in JSON why there is no result, unless a part of it was printed."""
        if not self._printed:
            self.document({"error": text, "exit_code": code})

    def lap(self, name: str, *, compiling: float | None = None) -> None:
        """End a part of the run, and record its wall time.

        The time `compiling` within it is recorded apart, as "compile" [s].
        """
        now = time.time()
        if compiling is not None:
            self.laps["compile"] = compiling
        self.laps[name] = now - self.last - (compiling or 0.0)
        self.last = now

    def times(self) -> None:
        parts = ", ".join(f"{name} {s:.1f} s" for name, s in self.laps.items())
        self.note(f"Time: {parts}; {time.time() - self.begin:.1f} s in all.")

    def _beat(self) -> None:
        """Say what is under way after a long silence."""
        while not self._over.wait(0.2):
            if self._what and time.monotonic() - self._said >= SILENCE_S:
                words = ", ".join(filter(None, [self._what, self.compiling.words()]))
                self.note(f"  {words}; {time.time() - self.begin:.0f} s so far")


class _UnderWay(ProgressColumn):
    """Time since the command began, what is under way, and what is compiled for it."""

    def __init__(self, compiling: Compiling, begin: float):
        super().__init__()
        self._compiling, self._begin = compiling, begin

    def render(self, task: Task) -> Text:
        elapsed = timedelta(seconds=int(time.time() - self._begin))
        words = filter(None, [task.description, self._compiling.words()])
        return Text(f"{elapsed} {', '.join(words)}")


def silence() -> None:
    """Keep what XLA and JAX write for their developers from the user's terminal.

    Call it before JAX is imported. What is set in the environment already is left, so
    that a developer can ask for it: TF_CPP_MIN_LOG_LEVEL, JAX_LOGGING_LEVEL.
    """
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    if not {"JAX_LOGGING_LEVEL", "JAX_LOG_COMPILES"} & set(os.environ):
        for name in ("jax", "jaxlib", "absl"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
