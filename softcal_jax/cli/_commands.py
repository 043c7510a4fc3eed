"""The commands; heavy packages are imported only when one runs."""

import argparse
import math
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from softcal_jax.cli._display import Display
from softcal_jax.cli._shared import (
    BAD_INPUT,
    NOT_CONVERGED,
    OK,
    Stop,
    bad_input,
    check_folder,
    load,
    no_equilibrium,
    print_end,
)

if TYPE_CHECKING:
    from softcal_jax.calibration import (
        CalibrationResult,
        ConfigurationResult,
        HistoryEntry,
    )
    from softcal_jax.fields import Parameter
    from softcal_jax.project import Project

MOST_BY_NAME, MOST_IN_FIELD = 2, 4
"""Most parameters that a step shows by name, and most values of one field."""


def demo(args: argparse.Namespace, show: Display) -> int:
    """Calibrate the silicone beam, or write its project file."""
    from softcal_jax.robots import silicone_beam_path

    if args.write is None:
        return calibrate(args, show, silicone_beam_path())
    source = silicone_beam_path().parent
    names = sorted(p.name for p in source.iterdir() if p.is_file())
    there = [name for name in names if (args.write / name).exists()]
    if there and not args.force:
        raise Stop(
            BAD_INPUT,
            f"error: {args.write} has {', '.join(there)} already. Choose another "
            "folder, or replace them with --force.",
        )
    with bad_input():
        args.write.mkdir(parents=True, exist_ok=True)
        for name in names:
            shutil.copyfile(source / name, args.write / name)
    show.line(f"Wrote {', '.join(names)} to {args.write}. To calibrate it:")
    show.line(f"  softcal calibrate {args.write / 'project.toml'} -o results")
    return OK


def calibrate(args: argparse.Namespace, show: Display, path: Path) -> int:
    """Fit a project, predict what was held out, and write the results."""
    check_folder(args)
    from softcal_jax import report
    from softcal_jax.identifiability import assess

    project = load(path, show)
    with bad_input():
        project.check_calibration()
    for role, group in (("fit", project.calibration), ("predict", project.validation)):
        if group:
            show.line(f"{role}: {', '.join(c.name for c in group)}")
    _print_registrations(project, show)
    show.now("first equilibrium (compiling)")
    with bad_input(), no_equilibrium("Nothing was written."):
        result = project.calibrate(
            checkpoint=args.checkpoint,
            progress=_step_lines(project, show),
            search_progress=lambda search: show.line(f"search   {search}"),
        )
    show.lap("solve")
    show.split("solve", "compile", result.timing_s["compile"])
    assessment = assess(result)

    def write(result: "CalibrationResult", *, force: bool) -> Path:
        show.now("writing results and pictures")
        with bad_input():
            folder = report.write_results(
                result,
                args.output,
                name=project.name,
                force=force,
                assessment=assessment,
                timing_s=dict(show.laps),
            )
        show.lap("results and pictures")
        return folder

    where = write(result, force=args.force)
    if project.intervals is not None and result.converged:
        # The results are written already, in case the user does not want to wait.
        several = "s" if len(result.parameters) > 1 else ""
        show.now(f"intervals of {len(result.parameters)} parameter{several}")
        result = project.with_intervals(result)
        show.lap("intervals")
        where = write(result, force=True)
    show.line()
    show.line(report.summary_table(result, assessment))
    _print_held_out(result, show)
    print_end(where, show)
    if not result.converged:
        steps = len(result.history) - 1
        raise Stop(
            NOT_CONVERGED, f"not converged after {steps} steps: do not use the values."
        )
    return OK


def simulate(args: argparse.Namespace, show: Display) -> int:
    """Solve all configurations of a project at the start values.

    Those without an equilibrium are named at the end, after the others are written.
    """
    check_folder(args)
    from softcal_jax import report
    from softcal_jax.calibration import Clock, simulation_result
    from softcal_jax.equilibrium import check_converged

    project = load(args.project, show)
    names = tuple(c.name for c in project.configurations)
    show.now(f"equilibrium of {', '.join(names)} (compiling)")
    with Clock() as clock:
        solution = project.simulate()
    show.lap("solve")
    show.split("solve", "compile", clock.seconds["compile"])

    show.now("writing results and pictures")
    with bad_input():
        result = simulation_result(project.model, project.configurations, solution)
        where = report.write_simulation(
            result,
            args.output,
            name=project.name,
            force=args.force,
            timing_s=dict(show.laps),
        )
    show.lap("results and pictures")
    show.line()
    show.line(report.simulation_table(result))
    print_end(where, show)
    with no_equilibrium("The results hold the others, if any."):
        check_converged(solution, names)
    return OK


def _print_registrations(project: "Project", show: Display) -> None:
    if project.registrations:
        listed = ", ".join(
            f"{name} {1e3 * registration.rms:.2f} mm"
            for name, registration in project.registrations.items()
        )
        show.line(f"camera frame to mesh frame, rms left at the markers: {listed}")


def _step_lines(project: "Project", show: Display) -> "Callable[[HistoryEntry], None]":
    """Return a callback that prints a line per step and says what comes next."""
    sees_points = any(c.has_points for c in project.calibration)

    def misfit(entry: "HistoryEntry") -> str:
        # Lengths, angles and forces have no distance, so show the cost.
        if sees_points:
            return f"rms {1e3 * entry.rms:7.3f} mm"
        return f"cost {entry.cost:9.3g}"

    def progress(entry: "HistoryEntry") -> None:
        size = max(abs(step) for step in entry.lambda_p)
        moved = f"|lambda_p| {size:.1e}" if entry.step else " " * 18
        values = _values(project.parameters, entry.values)
        refused = "" if entry.accepted else "   (step refused)"
        what = f"step {entry.step}" if entry.step else "start"
        show.line(f"{what:<8} {misfit(entry)}   {moved}   {values}{refused}")
        last = entry.step == project.settings.max_steps
        finished = last or (entry.step > 0 and size <= project.settings.tol)
        if finished and project.validation:
            show.now(f"predicting {', '.join(c.name for c in project.validation)}")
        else:
            show.now(f"step {entry.step + 1}", log=False)

    return progress


def _values(parameters: "Sequence[Parameter]", values: Mapping[str, float]) -> str:
    """Format values on one line, with those of a field at control points together."""
    from softcal_jax.export import readable_unit

    fields: dict[str, list[Parameter]] = {}
    for parameter in parameters:
        at_points = len(parameters) > MOST_BY_NAME
        key = parameter.field if at_points else parameter.name
        fields.setdefault(key, []).append(parameter)
    texts = []
    for name, members in fields.items():
        own = [values[q.name] for q in members]
        factor, unit = readable_unit(own, members[0].unit)
        shown = [_rounded(factor * value, unit) for value in own]
        text = ", ".join(shown)
        if len(shown) > MOST_IN_FIELD:
            low, high = min(own), max(own)
            text = f"{_rounded(factor * low, unit)} to {_rounded(factor * high, unit)}"
        texts.append(f"{name} = {text} {unit}".rstrip())
    return "; ".join(texts) if len(parameters) > MOST_BY_NAME else ", ".join(texts)


def _rounded(value: float, unit: str) -> str:
    return f"{value:.2f}" if unit else f"{value:.5g}"


def _print_held_out(result: "CalibrationResult", show: Display) -> None:
    for fit in result.configurations:
        if fit.role == "validation":
            found = _held_out_errors(fit)
            if found:
                show.line(f"Held-out error, {fit.name}: {found}.")


def _held_out_errors(fit: "ConfigurationResult") -> str:
    """Format distances of markers and angles of orientations, where there are any."""
    texts = []
    if fit.points:
        n = len(fit.points)
        percent = (
            f", {100 * fit.rms_share:.1f} % of how far they moved "
            f"({1e3 * fit.motion:.1f} mm)"
            if math.isfinite(fit.rms_share)
            else ""
        )
        texts.append(
            f"{1e3 * fit.rms_after:.2f} mm rms over {n} marker{'s' if n > 1 else ''}"
            f"{percent}"
        )
    if math.isfinite(fit.turn_after):
        texts.append(f"{math.degrees(fit.turn_after):.2f} deg rms of orientations")
    return "; ".join(texts)
