"""Lines for the steps of a calibration, and writing its results.

Neither an interruption nor a full disk loses the results.
"""

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softcal_jax.cli._display import Display
from softcal_jax.cli._shared import BAD_INPUT, INTERRUPTED, Stop, bad_input

if TYPE_CHECKING:
    from softcal_jax.calibration import CalibrationResult, HistoryEntry
    from softcal_jax.equilibrium import EquilibriumProgress
    from softcal_jax.fields import Parameter
    from softcal_jax.project import Project

MOST_IN_FIELD = 4  # values of one field that a step shows one by one
MOST_NAMED = 4  # fields and other parameters that a step shows


def write_results(
    write: Callable[..., Path], args: argparse.Namespace, show: Display, *, index: str
) -> None:
    """Write results that are printed already, and say where; as JSON, print `index`.

    `write` is a function of `report` that takes a folder, `force` and `timing_s`. Where
    the folder cannot be written any more, as on a full disk, the results go to a
    temporary one, and the command ends with a message.
    """
    show.now("writing results")
    with bad_input():
        try:
            where = write(args.output, force=args.force, timing_s=show.laps)
        except OSError as error:
            more = f"{_elsewhere(write, show)} {checkpoint_stands(args)}".strip()
            raise Stop(BAD_INPUT, f"error: {error}\n{more}") from error
    show.lap("results and pictures")
    if show.as_json:
        show.document(json.loads((where / index).read_text(encoding="utf-8")))
    show.times()
    more = " --verbose prints its tables." * (not getattr(args, "verbose", True))
    show.line(f"Results in {where}: open {where / 'report.html'} in a browser.{more}")


def pictures_with_a_bar(args: argparse.Namespace, show: Display) -> dict[str, Any]:
    """Return the format of the pictures, and a callback that shows their progress."""
    progress = lambda done, total: show.now(
        "drawing pictures", log=False, count=(done, total)
    )
    none = args.no_pictures or getattr(args, "quick", False)
    return {"pictures": None if none else args.pictures, "progress": progress}


def _elsewhere(write: Callable[..., Path], show: Display) -> str:
    """Write results to a temporary folder, and say what became of them."""
    try:
        second = Path(tempfile.mkdtemp(prefix="softcal_"))
        write(second, timing_s=show.laps)
    except OSError as error:
        return f"They could not be written elsewhere ({error}); they are printed above."
    return f"The results are in {second} instead: copy them before it is emptied."


@contextmanager
def interruptible(args: argparse.Namespace) -> Iterator[None]:
    """End an interrupted calibration with how to go on from its checkpoint."""
    try:
        yield
    except KeyboardInterrupt:
        stands = checkpoint_stands(args)
        if not stands:
            raise
        raise Stop(INTERRUPTED, f"interrupted. {stands}") from None


def checkpoint_stands(args: argparse.Namespace) -> str:
    """Say how to go on from the checkpoint; empty if there is none."""
    path = getattr(args, "checkpoint", None)
    if path is None or not path.is_file():
        return ""
    return (
        f"The checkpoint {path} is kept: the same command resumes from it, with "
        "--force if the results folder is no longer empty."
    )


def step_lines(project: "Project", show: Display) -> "Callable[[HistoryEntry], None]":
    """Return a callback that prints a line per step and says what comes next."""
    sees_points = any(c.has_points for c in project.calibration)
    noise: float | None = None

    def progress(entry: "HistoryEntry") -> None:
        nonlocal noise
        # Lengths, angles and forces have no distance, so show the cost.
        misfit = f"cost {entry.cost:9.3g}"
        if sees_points:
            misfit = f"rms {1e3 * entry.rms:7.3f} mm"
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
    """Print the values before the error budget, intervals and pictures."""
    from softcal_jax.export import readable_estimate
    from softcal_jax.report import held_out_sentences

    show.note("Preliminary values, with standard errors from the noise alone:")
    for p in result.parameters:
        value = readable_estimate(p.value, p.standard_error, p.unit)
        show.note(f"  {p.name} = {value}")
    if any(fit.points for fit in result.configurations):
        show.note(f"  Residuals: {1e3 * result.history[-1].rms:.2f} mm rms")
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
    from softcal_jax.export import readable_unit

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
