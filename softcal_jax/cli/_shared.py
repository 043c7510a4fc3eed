"""What all commands share: options, loading a project, its steps, writing results.

Neither an interruption nor a full disk loses the results.
"""

import argparse
import json
import math
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import shtab

from softcal_jax._places import cause, check_place
from softcal_jax._text import SoftcalWarning, escaped, listed, with_short_names
from softcal_jax.cli._display import Display

if TYPE_CHECKING:
    from softcal_jax.calibration import CalibrationResult, HistoryEntry
    from softcal_jax.equilibrium import EquilibriumProgress
    from softcal_jax.fields import Parameter
    from softcal_jax.project import Project

OK, NOT_CONVERGED, BAD_INPUT, NOT_TO_USE, INTERRUPTED = 0, 1, 2, 3, 130  # exit codes
AGAIN = "replace earlier results in that folder"  # what --force does
MOST_IN_FIELD = 4  # values of one field that a step shows one by one
MOST_NAMED = 4  # fields and other parameters that a step shows


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


def with_care(content: Mapping[str, Any]) -> list[str]:
    """Write what a loaded calibration doubts as a note for whoever uses its values."""
    said = content["assessment"]
    useless = said.get("outcome") == "do not use"
    what = "do not use the values" if useless else "take the values with care"
    return [f"{what}: {' '.join(said['reasons'])}"] if said["reasons"] else []


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
        text = "format of the pictures: png (default), or svg or pdf, for print"
        formats = {"choices": ["png", "svg", "pdf"], "default": "png"}
        which.add_argument("--pictures", **formats, help=text)


def check_folder(args: argparse.Namespace) -> None:
    """Check the output folder, if there is one, before a long run would fail there."""
    from softcal_jax.results import check_results_folder

    with bad_input():
        if args.output is not None:
            check_results_folder(args.output, force=args.force)


def check_new(*paths: Path, force: bool) -> None:
    """End the command if files cannot be made, or are there and may not be replaced."""
    with bad_input():
        for path in paths:
            check_place(path)
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
    from softcal_jax.results import model_words

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
    """End the command if its input is wrong, or there is no equilibrium."""
    import jax

    try:
        with bad_input():
            yield
    except jax.errors.JaxRuntimeError:
        raise  # a fault of the program, not of the robot
    except RuntimeError as error:
        raise Stop(NOT_CONVERGED, f"error: {error}\n{written}") from error


@contextmanager
def bad_input(*others: type[Exception]) -> Iterator[None]:
    """End the command if its input is wrong, or a package that it needs is missing."""
    try:
        yield
    except (ValueError, OSError, ImportError, *others) as error:
        raise refusal(error) from error


def refusal(error: Exception) -> Stop:
    """Make the message of an error; that of the system has a number and a path."""
    text = str(error)
    if isinstance(error, OSError) and error.filename is not None:
        text = f"{error.filename}: {cause(error)}; give another one."
    return Stop(BAD_INPUT, f"error: {with_short_names(text)}")


def write_results(
    result: Any, args: argparse.Namespace, show: Display, **about: Any
) -> None:
    """Write a result that is printed already, and say where; as JSON, print its file.

    `about` is what `results.write_results` takes besides. A command without a folder
    only prints the JSON. Where the folder cannot be written any more, as on a full
    disk, the results go to a temporary one, and the command ends with a message.
    """
    from softcal_jax.results import RESULT_KINDS, result_dict, write_results

    if args.output is None:
        show.document(result_dict(result, timing_s=show.laps, **about))
        show.times()
        return
    show.now("writing results")
    if "pictures" in args:
        drawing = partial(show.now, "drawing pictures", log=False)
        about["progress"] = lambda done, total: drawing(count=(done, total))
        about["pictures"] = None if args.no_pictures else args.pictures
    write = partial(write_results, result, **about)
    with bad_input():
        try:
            where = write(args.output, force=args.force, timing_s=show.laps)
        except OSError as error:
            more = f"{_elsewhere(write, show)} {checkpoint_stands(args)}".strip()
            raise Stop(BAD_INPUT, f"error: {error}\n{more}") from error
    show.lap("results and pictures")
    if show.as_json:
        index = where / f"{RESULT_KINDS[type(result)].file}.json"
        show.document(json.loads(index.read_text(encoding="utf-8")))
    show.times()
    more = " --verbose prints its tables." * (not getattr(args, "verbose", True))
    show.line(f"Results in {where}: open {where / 'report.html'} in a browser.{more}")


def _elsewhere(write: Callable[..., Path], show: Display) -> str:
    """Write results to a temporary folder, and say what became of them."""
    try:
        second = Path(tempfile.mkdtemp(prefix="softcal_"))
        write(second, timing_s=show.laps)
    except OSError as error:
        return f"They could not be written elsewhere ({error}); they are printed above."
    return f"All results are in {second}: copy them before it is emptied."


def checkpoint_stands(args: argparse.Namespace) -> str:
    """Say how to go on from the checkpoint; empty if there is none."""
    path = getattr(args, "checkpoint", None)
    if path is None or not path.is_file():
        return ""
    return (
        f"The checkpoint {path} is kept: the same command resumes from it, with "
        "--force if the results folder is no longer empty."
    )


def watch_lines(
    show: Display,
    step: "Callable[[HistoryEntry], None]",
    so_far: Callable[[Any], None] = lambda _: None,
) -> Callable[[Any], None]:
    """Return a `watch` that shows what happens; `step` and `so_far` print lines."""
    from softcal_jax.calibration import HistoryEntry, SearchProgress
    from softcal_jax.equilibrium import EquilibriumProgress

    equilibrium = equilibrium_lines(show)

    def watch(event: Any) -> None:
        match event:
            case str():
                show.now(event)
            case HistoryEntry():
                step(event)
            case SearchProgress():
                show.now(str(event), log=False)
            case EquilibriumProgress():
                equilibrium(event)
            case _:
                so_far(event)

    return watch


def step_lines(project: "Project", show: Display) -> "Callable[[HistoryEntry], None]":
    """Return a callback that prints a line per step and says what comes next."""
    from softcal_jax._units import readable

    noise: float | None = None

    def progress(entry: "HistoryEntry") -> None:
        nonlocal noise
        # Lengths, angles and forces have no distance, so show the cost.
        misfit = f"cost {entry.cost:9.3g}"
        if math.isfinite(entry.rms):
            misfit = f"rms {readable(entry.rms, 'step of a fit'):>10}"
        size = max(abs(step) for step in entry.lambda_p)
        moved = f"|lambda_p| {size:.1e}" if entry.step else " " * 18
        values = _values(project.parameters, entry.values)
        note = "" if entry.accepted else "   (step refused)"
        if noise not in (None, entry.noise_level):
            note += "   (noise re-estimated)"
        noise = entry.noise_level
        what = f"step {entry.step}" if entry.step else "start"
        show.note(f"{what:<8} {misfit}   {moved}   {values}{note}")
        more = f" of at most {project.settings.max_steps}"
        show.now(f"step {entry.step + 1}{more}", log=False)

    return progress


def so_far(result: "CalibrationResult", show: Display) -> None:
    """Print the values before their errors, and what may still change them."""
    from softcal_jax._units import readable, readable_estimate
    from softcal_jax.results import held_out_sentences

    of = "one start"
    if result.starts is not None and result.starts.optima:
        n, (best, *others) = len(result.starts.cost), result.starts.optima
        of = f"{len(best.starts)} of {n} starts"
        text = f"The starts disagree: {of} ended at the values below"
        for other in [optimum for optimum in others if optimum.starts][:1]:
            there = _values(result.space.parameters, other.values)
            text += f", {len(other.starts)} at {there}"
        if len(best.starts) < n:
            show.note(f"{text}.")
    show.note(f"Preliminary values, from {of}; {listed(result.left_out)} to come:")
    for p in result.parameters:
        show.note(f"  {p.name} = {readable_estimate(p.value, math.nan, p.unit)}")
    if math.isfinite(result.history[-1].rms):
        show.note(f"  Residuals: {readable(result.history[-1].rms, 'distance')} rms")
    for sentence in held_out_sentences(result.configurations):
        show.note(f"  {sentence}")


def equilibrium_lines(show: Display) -> "Callable[[EquilibriumProgress], None]":
    """Return a callback that shows the progress of equilibria that start from rest.

    A line that stays says when the moduli are raised above their start values.
    """
    raised = 1.0

    def progress(now: "EquilibriumProgress") -> None:
        nonlocal raised
        if now.stiffer > raised:
            raised = now.stiffer
            show.note(
                f"no equilibrium yet: moduli raised to {raised:g} times their start"
            )
        show.now(str(now), log=False)

    return progress


def _values(parameters: "Sequence[Parameter]", values: Mapping[str, float]) -> str:
    """Format values on one line, with those of a field at control points together."""
    from softcal_jax._units import readable_unit

    fields: dict[str, list[Parameter]] = {}
    for parameter in parameters:
        # What is not of the material, like the turn of a frame, sets no field.
        fields.setdefault(parameter.field or parameter.name, []).append(parameter)
    texts = []
    for field, members in fields.items():
        name = field if len(members) > 1 else members[0].name
        numbers = [values[q.name] for q in members]
        factor, unit = readable_unit(numbers, members[0].unit)
        digits = ".2f" if unit else ".5g"
        text = ", ".join(f"{factor * value:{digits}}" for value in numbers)
        if len(numbers) > MOST_IN_FIELD:
            low, high = factor * min(numbers), factor * max(numbers)
            text = f"{low:{digits}} to {high:{digits}}"
        texts.append(f"{name} = {text} {unit}".rstrip())
    more = len(texts) - MOST_NAMED
    return "; ".join(texts[:MOST_NAMED] + [f"{more} more"] * (more > 0))
