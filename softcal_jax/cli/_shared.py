"""What all commands share: exit codes, output, loading a project, ending a command."""

import argparse
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from softcal_jax._text import escaped
from softcal_jax.cli._console import PlainConsole

if TYPE_CHECKING:
    from softcal_jax.project import Project

OK, NOT_CONVERGED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
"""Exit codes."""


class Stop(Exception):
    """End the command with a message instead of a traceback."""

    def __init__(self, code: int, text: str):
        super().__init__(text)
        self.code = code


class Display:
    """Lines for what is done; on a terminal, a spinner for what is under way.

    Attributes:
        laps: Wall time of the parts so far [s].
    """

    def __init__(self, begin: float):
        self.console = PlainConsole(file=sys.stdout)
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

    def lap(self, name: str, *, compiling: float | None = None) -> None:
        """End a part of the run, and record its wall time.

        The time that it was compiling is recorded as a part of its own, before it [s].
        """
        now = time.time()
        if compiling is not None:
            self.laps["compile"] = compiling
        self.laps[name] = now - self.last - (compiling or 0.0)
        self.last = now

    def times(self) -> None:
        """Print how long the parts took."""
        parts = ", ".join(f"{name} {s:.1f} s" for name, s in self.laps.items())
        self.line(f"Time: {parts}; {time.time() - self.begin:.1f} s in all.")

    def results(self, where: Path) -> None:
        """Print what was written where, and how long the parts took."""
        files = sorted(p.name for p in where.iterdir())
        self.line(f"Results in {where}: {', '.join(files)}")
        self.line(f"Open {where / 'report.html'} in a browser to read them.")
        self.times()


@contextmanager
def sigterm_as_ctrl_c() -> Iterator[None]:
    """Let SIGTERM, by which schedulers end a job, end the command as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may choose
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before or signal.SIG_DFL)


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
    from softcal_jax.project import ProjectWarning
    from softcal_jax.report import PictureWarning, ResultWarning

    own = (
        CalibrationWarning,
        CompilationCacheWarning,
        MeshWarning,
        ProjectWarning,
        PictureWarning,
        ResultWarning,
        TrackerWarning,
    )
    with warnings.catch_warnings():
        plain = warnings.showwarning

        def line(message, category, *where, **more):
            mended = throw_away_damaged(str(message))
            if issubclass(category, own) or mended:
                show.line(f"warning: {mended or message}")
            else:
                plain(escaped(str(message)), category, *where, **more)

        warnings.showwarning = line
        for category in own:
            warnings.simplefilter("always", category)
        yield


def add_path(
    parser: argparse.ArgumentParser, name: str, metavar: str, text: str, **more: Any
) -> None:
    """Add an argument that is a path; `--output` is also `-o`."""
    names = ["-o", name] if name == "--output" else [name]
    parser.add_argument(*names, metavar=metavar, type=Path, help=text, **more)


def check_folder(args: argparse.Namespace) -> None:
    """Check the output folder first, so that a long run does not fail there."""
    from softcal_jax.export import check_results_folder

    with bad_input():
        check_results_folder(args.output, force=args.force)


def check_new(*paths: Path, force: bool) -> None:
    """End the command if there are such files already, unless they may be replaced."""
    there = [str(path) for path in paths if path.exists()]
    if there and not force:
        verb, them = ("exists", "it") if len(there) == 1 else ("exist", "them")
        raise Stop(
            BAD_INPUT,
            f"error: {' and '.join(there)} {verb} already. Choose another name, or "
            f"replace {them} with --force.",
        )


def quantity(option: str, text: str, unit: str) -> float:
    """Parse the value of an option into the SI unit; the error names the option."""
    from softcal_jax.project import parse_in_si

    try:
        return parse_in_si(text, unit)
    except ValueError as error:
        raise ValueError(f"{option}: {error}") from error


def start_computing(show: Display) -> None:
    """Choose the precision, and the folder of compiled programs.

    Only a program may do this; a library must leave them to its user.
    """
    import jax

    from softcal_jax._compilation_cache import use_compilation_cache

    jax.config.update("jax_enable_x64", True)
    use_compilation_cache()
    show.lap("import")


def load(path: Path, show: Display, *, solve: bool = True) -> "Project":
    """Load a project, and describe its model, with the solver if it is to `solve`."""
    from softcal_jax.project import load_project
    from softcal_jax.report import model_words

    start_computing(show)
    show.now(f"reading {path.name}")
    with bad_input():
        project = load_project(path, solve=solve)
    show.lap("reading")
    show.line(f"softcal {version('softcal-jax')}: {project.name}")
    model = project.model
    solver = f", solver {model.solver.name}" if solve else ""
    show.line(f"{model_words(model)}{solver}")
    return project


@contextmanager
def no_equilibrium(written: str) -> Iterator[None]:
    """End the command if a configuration has no equilibrium."""
    import jax

    try:
        yield
    except jax.errors.JaxRuntimeError:
        raise  # a fault of the program, not of the robot
    except RuntimeError as error:
        raise Stop(NOT_CONVERGED, f"error: {error}\n{written}") from error


@contextmanager
def bad_input() -> Iterator[None]:
    """End the command if its input is wrong."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise Stop(BAD_INPUT, f"error: {error}") from error
