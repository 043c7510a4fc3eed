"""What all commands share: exit codes, output, loading a project, ending a command."""

import argparse
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import shtab

from softcal_jax._text import escaped
from softcal_jax._warnings import SoftcalWarning
from softcal_jax.cli._display import Display

if TYPE_CHECKING:
    from softcal_jax.project import Project

OK, NOT_CONVERGED, BAD_INPUT, NOT_TO_USE, INTERRUPTED = 0, 1, 2, 3, 130  # exit codes


class Stop(Exception):
    """End the command with a message instead of a traceback."""

    def __init__(self, code: int, text: str):
        super().__init__(text)
        self.code = code


@contextmanager
def sigterm_as_ctrl_c() -> Iterator[None]:
    """Let SIGTERM, by which schedulers end a job, end the command as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread can set a handler
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before or signal.SIG_DFL)


def with_care(outcome: str, doubts: Sequence[str]) -> list[str]:
    """Write the doubts about calibrated values as notes for whoever uses the values."""
    useless = outcome == "do not use"
    what = "do not use the values" if useless else "take the values with care"
    return [f"{what}: {reason}" for reason in doubts]


@contextmanager
def warnings_as_lines(show: Display) -> Iterator[None]:
    """Show the package's own warnings as lines, without file and line of code.

    Warnings of other packages are for developers: they are shown only where Python was
    asked for warnings, with -W or PYTHONWARNINGS.
    """
    from softcal_jax._compilation_cache import throw_away_damaged

    with warnings.catch_warnings():
        plain = warnings.showwarning

        def line(message, category, *where, **more):
            mended = throw_away_damaged(str(message))
            if issubclass(category, SoftcalWarning) or mended:
                show.warning(mended or str(message))
            elif sys.warnoptions:
                plain(escaped(str(message)), category, *where, **more)

        warnings.showwarning = line
        warnings.simplefilter("always", SoftcalWarning)
        yield


def add_path(
    parser: argparse._ActionsContainer, name: str, metavar: str, text: str, **more: Any
) -> None:
    """Add an argument that is a path; `--output` is also `-o`."""
    names = ["-o", name] if name == "--output" else [name]
    added = parser.add_argument(*names, metavar=metavar, type=Path, help=text, **more)
    kind = shtab.DIRECTORY if metavar == "DIR" else shtab.FILE
    added.complete = kind  # pyright: ignore[reportAttributeAccessIssue]


def add_output(
    command: argparse.ArgumentParser, *, force: str = "", pictures: bool = False
) -> None:
    """Add the options on replacing files, on what is printed, and on `pictures`."""
    if force:
        command.add_argument("--force", action="store_true", help=force)
    text = "hide the progress: print only the result, warnings and errors"
    command.add_argument("--quiet", "-q", action="store_true", help=text)
    text = "print the result as JSON; everything else goes to standard error"
    command.add_argument("--json", action="store_true", help=text)
    if pictures:
        which = command.add_mutually_exclusive_group()
        text = "write no pictures"
        which.add_argument("--no-pictures", action="store_true", help=text)
        text = "format of the pictures: png (default) or svg, for print"
        which.add_argument(
            "--pictures", choices=["png", "svg"], default="png", help=text
        )


def check_folder(args: argparse.Namespace) -> None:
    """Check the output folder first, so that a long run does not fail there."""
    from softcal_jax.export import check_results_folder

    with bad_input():
        check_results_folder(args.output, force=args.force)


def check_new(*paths: Path, force: bool) -> None:
    """End the command if there are such files already, unless they may be replaced."""
    existing = [str(path) for path in paths if path.exists()]
    if existing and not force:
        verb, them = ("exists", "it") if len(existing) == 1 else ("exist", "them")
        raise Stop(
            BAD_INPUT,
            f"error: {' and '.join(existing)} {verb} already. Choose another name, or "
            f"replace {them} with --force.",
        )


def check_suffix(path: Path, *allowed: str) -> None:
    """End the command if the name of a file to be written ends in something else."""
    if path.suffix.lower() not in allowed:
        text = f"error: {path} ends in {path.suffix!r}; expected a name that ends in "
        raise Stop(BAD_INPUT, f"{text}{' or '.join(allowed)}.")


def start_computing(show: Display) -> None:
    """Choose the precision, and the folder of compiled programs.

    Only a program may do this; a library must leave them to its user.
    """
    import jax

    from softcal_jax._compilation_cache import use_compilation_cache

    jax.config.update("jax_enable_x64", True)
    use_compilation_cache()
    show.compiling.start()
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
    show.note(f"softcal {version('softcal-jax')}: {project.name}")
    model = project.model
    solver = f", solver {model.solver.name}" if solve else ""
    show.note(f"{model_words(model)}{solver}")
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
    """End the command if its input is wrong, or a package that it needs is missing."""
    try:
        yield
    except (ValueError, OSError, ImportError) as error:
        raise Stop(BAD_INPUT, f"error: {error}") from error
