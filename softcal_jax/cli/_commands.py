"""What the commands do; heavy packages are imported when one runs."""

import argparse
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from softcal_jax.cli._display import Display

if TYPE_CHECKING:
    from softcal_jax.calibration import CalibrationResult, HistoryEntry
    from softcal_jax.project import Project

OK, NOT_CONVERGED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
"""Exit codes."""


class Stop(Exception):
    """Ends the command with a message instead of a traceback."""

    def __init__(self, code: int, text: str):
        super().__init__(text)
        self.code = code


def demo(args: argparse.Namespace, show: Display) -> int:
    """Calibrates the silicone beam, or writes its project file."""
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
    with _bad_input():
        args.write.mkdir(parents=True, exist_ok=True)
        for name in names:
            shutil.copyfile(source / name, args.write / name)
    show.line(f"Wrote {', '.join(names)} to {args.write}. To calibrate it:")
    show.line(f"  softcal calibrate {args.write / 'project.toml'} -o results")
    return OK


def calibrate(args: argparse.Namespace, show: Display, path: Path) -> int:
    """Fits a project, predicts what was held out, and writes the results."""
    _check_folder(args)
    from softcal_jax import report

    project = _load(path, show)
    with _bad_input():
        project.check_calibration()
    for role, group in (("fit", project.calibration), ("predict", project.validation)):
        if group:
            show.line(f"{role}: {', '.join(c.name for c in group)}")
    _print_registrations(project, show)
    show.now("first equilibrium (compiling)")
    with _no_equilibrium("Nothing was written."):
        result = project.calibrate(progress=_step_lines(project, show))
    show.lap("solve")
    show.split("solve", "compile", result.timing_s["compile"])

    show.now("writing results and pictures")
    with _bad_input():
        where = report.write_results(
            result,
            args.output,
            name=project.name,
            force=args.force,
            timing_s=dict(show.laps),
        )
    show.lap("results and pictures")
    show.line()
    show.line(report.summary_table(result))
    _print_held_out(result, show)
    _print_end(where, show)
    if not result.converged:
        steps = len(result.history) - 1
        raise Stop(
            NOT_CONVERGED, f"not converged after {steps} steps: do not use the values."
        )
    return OK


def simulate(args: argparse.Namespace, show: Display) -> int:
    """Solves all configurations of a project with the start values.

    Those without an equilibrium are named at the end, after the others are written.
    """
    _check_folder(args)
    from softcal_jax import export, report
    from softcal_jax.calibration import Clock
    from softcal_jax.equilibrium import check_converged

    project = _load(args.project, show)
    names = tuple(c.name for c in project.configurations)
    show.now(f"equilibrium of {', '.join(names)} (compiling)")
    with Clock() as clock:
        solution = project.simulate()
    show.lap("solve")
    show.split("solve", "compile", clock.seconds["compile"])

    show.now("writing results and pictures")
    with _bad_input():
        where = report.write_simulation(
            project.model,
            project.configurations,
            solution,
            args.output,
            name=project.name,
            force=args.force,
            timing_s=dict(show.laps),
        )
    show.lap("results and pictures")
    show.line()
    data = export.simulation_dict(project.model, project.configurations, solution)
    show.line(report.simulation_table(data))
    _print_end(where, show)
    with _no_equilibrium("The results hold the others, if any."):
        check_converged(solution, names)
    return OK


def _check_folder(args: argparse.Namespace) -> None:
    """Before any work: a run of minutes must not end at a folder that exists."""
    from softcal_jax.export import check_results_folder

    with _bad_input():
        check_results_folder(args.output, force=args.force)


def _load(path: Path, show: Display) -> "Project":
    import jax

    from softcal_jax.project import load_project

    # For this process alone; a library must not switch it for its user.
    jax.config.update("jax_enable_x64", True)
    show.lap("import")
    show.now(f"reading {path.name}")
    with _bad_input():
        project = load_project(path)
    show.lap("reading")
    mesh, model = project.model.mesh, project.model
    kind = "quadratic" if mesh.order == 2 else "linear"
    show.line(f"softcal {version('softcal-jax')}: {project.name}")
    show.line(
        f"{mesh.n_nodes} nodes, {mesh.n_tets} {kind} tets, {type(model.law).__name__} "
        f"({model.formulation}), solver {model.solver.name}"
    )
    return project


def _print_registrations(project: "Project", show: Display) -> None:
    if project.registrations:
        listed = ", ".join(
            f"{name} {1e3 * registration.rms:.2f} mm"
            for name, registration in project.registrations.items()
        )
        show.line(f"camera frame to mesh frame, rms left at the markers: {listed}")


def _step_lines(project: "Project", show: Display) -> "Callable[[HistoryEntry], None]":
    """Prints a line per step, and says what comes next."""
    units = {p.name: p.unit for p in project.parameters}

    def progress(entry: "HistoryEntry") -> None:
        size = max(abs(step) for step in entry.lambda_p)
        moved = f"|lambda_p| {size:.1e}" if entry.step else " " * 18
        values = ", ".join(
            f"{name} = {_shown(value, units[name])}"
            for name, value in entry.values.items()
        )
        refused = "" if entry.accepted else "   (step refused)"
        what = f"step {entry.step}" if entry.step else "start"
        show.line(
            f"{what:<8} rms {1e3 * entry.rms:7.3f} mm   {moved}   {values}{refused}"
        )
        last = entry.step == project.settings.max_steps
        finished = last or (entry.step > 0 and size <= project.settings.tol)
        if finished and project.validation:
            show.now(f"predicting {', '.join(c.name for c in project.validation)}")
        else:
            show.now(f"step {entry.step + 1}", log=False)

    return progress


def _shown(value: float, unit: str) -> str:
    if unit == "Pa":
        return f"{value / 1e3:.2f} kPa"
    return f"{value:.5g} {unit}".strip()


def _print_held_out(result: "CalibrationResult", show: Display) -> None:
    for fit in result.configurations:
        if fit.role == "validation":
            percent = (
                f", {100 * fit.rms_after / fit.motion:.1f} % of how far they moved "
                f"({1e3 * fit.motion:.1f} mm)"
                if fit.motion > 0.0
                else ""
            )
            show.line(
                f"Held-out error, {fit.name}: {1e3 * fit.rms_after:.2f} mm rms over "
                f"{len(fit.marker_names)} markers{percent}."
            )


def _print_end(where: Path, show: Display) -> None:
    files = sorted(p.name for p in where.iterdir())
    show.line(f"Results in {where}: {', '.join(files)}")
    parts = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in show.laps.items())
    show.line(f"Time: {parts}; {show.total():.1f} s in all.")


@contextmanager
def _no_equilibrium(written: str) -> Iterator[None]:
    import jax

    try:
        yield
    except jax.errors.JaxRuntimeError:
        raise  # a fault of the program, not of the robot
    except RuntimeError as error:
        raise Stop(NOT_CONVERGED, f"error: {error}\n{written}") from error


@contextmanager
def _bad_input() -> Iterator[None]:
    try:
        yield
    except (ValueError, OSError) as error:
        raise Stop(BAD_INPUT, f"error: {error}") from error
