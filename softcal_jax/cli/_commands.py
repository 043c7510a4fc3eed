"""The commands; heavy packages are imported only when one runs."""

import argparse
import shutil
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softcal_jax.cli import _shared as cli

if TYPE_CHECKING:
    from softcal_jax.calibration import CalibrationResult
    from softcal_jax.configurations import Configuration
    from softcal_jax.export import Made
    from softcal_jax.project import Project


def demo(args: argparse.Namespace, show: cli.Display) -> None:
    from softcal_jax.robots import ready_made_path

    path = ready_made_path({"beam": "beam", "arm": "pneumatic-arm"}[args.robot])
    if args.write is None:
        args.project = path
        return calibrate(args, show)
    source = path.parent
    names = sorted(p.name for p in source.iterdir() if p.is_file())
    with cli.bad_input():
        args.write.mkdir(parents=True, exist_ok=True)
    cli.check_new(*(args.write / name for name in names), force=args.force)
    with cli.bad_input():
        for name in names:
            shutil.copyfile(source / name, args.write / name)
    show.document({"directory": str(args.write), "files": names})
    show.line(f"Wrote {', '.join(names)} to {args.write}. To calibrate it:")
    show.line(f"  softcal calibrate {args.write / 'project.toml'} -o results")


def calibrate(args: argparse.Namespace, show: cli.Display) -> None:
    cli.check_folder(args)
    from softcal_jax import report
    from softcal_jax._units import readable
    from softcal_jax.identifiability import assess

    project = cli.load(args.project, show)
    with cli.bad_input():
        project.check_calibration()
    show.note(f"fit: {_names(project.calibration)}")
    if project.validation:
        show.note(f"predict: {_names(project.validation)}")
    if project.registrations:
        left = (
            f"{n} {readable(r.rms, 'distance')}"
            for n, r in project.registrations.items()
        )
        show.note(f"camera frame to mesh frame, rms residuals: {', '.join(left)}")
    show.now("first equilibrium")
    with cli.no_equilibrium("Nothing was written."):
        result = project.calibrate(
            checkpoint=args.checkpoint,
            watch=cli.watch_lines(
                show,
                cli.step_lines(project, show),
                lambda result: cli.so_far(result, show),
            ),
        )
    show.lap("solve", compiling=result.timing_s["compile"])
    assessment = assess(result)
    if result.beyond_noise and not result.interrupted:
        result = _with_mistakes(result, show)
    show.line()
    tree = report.calibration_sections(result, assessment)
    show.line(report.console(tree, short=not args.verbose))
    more = {"name": project.name, "traces": project.traces}
    write = partial(report.write_results, result, assessment=assessment, **more)
    cli.write_results(write, args, show, index="result.json")
    steps = len(result.history) - 1
    if result.interrupted:
        end = "" if result.converged else ", not converged"
        text = f"interrupted after {steps} steps{end}. {cli.checkpoint_stands(args)}"
        raise cli.Stop(cli.INTERRUPTED, text.strip())
    if not result.converged:
        text = f"not converged after {steps} steps."
        raise cli.Stop(cli.NOT_CONVERGED, text)
    if assessment.outcome == "do not use":
        raise cli.Stop(
            cli.NOT_TO_USE, "the model is far from the data: see the verdict."
        )


def _with_mistakes(
    result: "CalibrationResult", show: cli.Display
) -> "CalibrationResult":
    """Search the likeliest mistake, which stands above the answer; or Ctrl-C."""
    from softcal_jax.mistakes import likely_mistakes

    show.now("the likeliest mistake in the data or the project")
    try:
        mistakes = tuple(map(str, likely_mistakes(result)))
    except KeyboardInterrupt:
        notes = (*result.notes, "Interrupted while mistakes were sought.")
        return replace(result, notes=notes, interrupted=True)
    show.lap("mistakes")
    return replace(result, mistakes=mistakes)


def simulate(args: argparse.Namespace, show: cli.Display) -> None:
    cli.check_folder(args)
    from softcal_jax import report
    from softcal_jax._process import Clock
    from softcal_jax.equilibrium import check_converged

    project = cli.load(args.project, show)
    show.now(f"equilibrium of {_names(project.configurations)}")
    progress = cli.equilibrium_lines(show)
    with Clock() as clock, cli.bad_input():
        values = args.values and report.load_values(args.values)
        result, solution = project.simulate(values, progress=progress)
    if values is not None:
        names = ", ".join(q.name for q in project.parameters)
        show.note(f"values of {args.values}: {names}")
    show.lap("solve", compiling=clock.seconds["compile"])
    show.line()
    show.line(report.console(report.sections(result)))
    more = {"name": project.name, "traces": project.traces}
    more |= {"calibration": args.values and report.result_path(args.values)}
    write = partial(report.write_results, result, made=_made(project), **more)
    cli.write_results(write, args, show, index="simulation.json")
    # Who has no equilibrium is named once the results are written.
    with cli.no_equilibrium("The results contain the others, if any."):
        check_converged(solution, tuple(c.name for c in project.configurations))


def design(args: argparse.Namespace, show: cli.Display) -> None:
    cli.check_folder(args)
    from softcal_jax import report
    from softcal_jax.exchange.icesl import Design, export_icesl
    from softcal_jax.export import headline

    project = cli.load(args.project, show)
    with cli.bad_input():
        project.check_design()
    show.note(f"goals: {_names(project.asked.goals)}")
    show.now("first equilibrium")
    step = lambda entry: show.note(f"step {entry.step:<3} cost {entry.cost:9.3g}")
    with cli.no_equilibrium("Nothing was written."):
        so_far = lambda result: show.note(headline(result))
        result = project.design(watch=cli.watch_lines(show, step, so_far))
    show.lap("design", compiling=result.fit.timing_s["compile"])
    show.line()
    show.line(report.console(report.sections(result)))
    write = partial(report.write_results, result, name=project.name, project=project)
    cli.write_results(write, args, show, index="design.json")
    if result.foam is not None:
        ordered = Design(project.model, result.fit.space, result.fit.z, project.name)
        printed = {"infill": result.foam.infill, "table": result.foam, "force": True}
        with cli.bad_input():
            written = export_icesl(ordered, args.output / "icesl", **printed)
        show.line(f"To print it: {written.directory / 'robot.lua'}, for IceSL.")
    if result.fit.interrupted:
        text = "interrupted: the design is that of the last step, without what follows."
        raise cli.Stop(cli.INTERRUPTED, text)
    if not result.met:
        raise cli.Stop(cli.NOT_CONVERGED, headline(result))


def identify(args: argparse.Namespace, show: cli.Display) -> None:
    cli.check_folder(args)
    from softcal_jax import report
    from softcal_jax.export import result_dict

    project = cli.load(args.project, show)
    with cli.bad_input():
        project.check_identify()
        if args.aim is not None:
            from softcal_jax.project import parse_in_si

            project = replace(project, precision=parse_in_si(args.aim, "%"))
    outlook = ranking = None
    blind = [c for c in project.calibration if not (c.markers or c.effectors)]
    with cli.no_equilibrium("Nothing was written."):
        if project.calibration:
            show.now(f"what the data of {_names(project.calibration)} would determine")
            outlook = project.identify(progress=cli.equilibrium_lines(show))
            show.lap("solve")
            show.line()
            if blind:
                without = _names(blind)
                show.line(f"Without markers or effectors, so without data: {without}.")
            show.line("At the start values, with the stated noise of the measurements:")
            show.line(f"{outlook}\n")
        candidates = (*project.candidates, *project.proposals)
        if candidates:
            show.now(f"what {_names(candidates)} would add")
            progress = cli.equilibrium_lines(show)
            ranking = project.rank_candidates(proposals=True, progress=progress)
            show.lap("candidates")
            show.line(f"{ranking}\n")
    made = _made(project, precision=project.precision)
    more: dict[str, Any] = {"name": project.name, "made": made}
    result: Any = outlook or ranking
    more["ranking"] = ranking
    if args.output is None:
        show.document(result_dict(result, timing_s=show.laps, **more))
        show.times()
    else:
        write = partial(report.write_results, result, **more)
        cli.write_results(write, args, show, index="identifiability.json")


def _made(project: "Project", **settings: Any) -> "Made":
    """Collect what a project was solved with: model, `settings`, and its file."""
    from softcal_jax.export import Made

    return Made(project.model, {**settings, "newton": project.newton}, project.source)


def _names(group: "Sequence[Configuration]") -> str:
    return ", ".join(c.name for c in group)


_COMPARE = """\
examples:
  softcal compare neo_hookean.toml yeoh.toml gent.toml
  softcal compare coarse.toml fine.toml -o compared   and as comparison.json and .txt

exit codes: 0 compared, whatever the verdict, 1 no model predicts every configuration,
2 bad input
"""


def compare(args: argparse.Namespace, show: cli.Display) -> None:
    cli.check_folder(args)
    from softcal_jax import report
    from softcal_jax.export import result_dict
    from softcal_jax.project import compare_projects, projects_by_name

    projects = [cli.load(path, show) for path in args.projects]
    n = sum(len(project.calibration) + 1 for project in projects)
    show.note(f"{n} fits, each to all configurations or to all but one")
    with cli.no_equilibrium("Nothing was written."):
        progress = lambda name: show.now(f"fits of {name}")
        comparison = compare_projects(projects, progress=progress)
    show.lap("solve")
    named = projects_by_name(projects).items()
    made = {name: _made(project) for name, project in named}
    show.line()
    show.line(str(comparison))
    if args.output is None:
        show.document(result_dict(comparison, timing_s=show.laps, made=made))
        show.times()
    else:
        write = partial(report.write_results, comparison, made=made)
        cli.write_results(write, args, show, index="comparison.json")
    if comparison.best is None:
        raise cli.Stop(cli.NOT_CONVERGED, "no model predicts every configuration.")


def add_compare(commands: "argparse._SubParsersAction") -> None:
    command = commands.add_parser(
        "compare",
        help="which law or mesh predicts best? fits to the same data",
        description="""\
Fits each project to all configurations but one and predicts the one left out, for each
configuration in turn. Ranks the projects by held-out error, and says whether the data
can distinguish them, from the scatter of the differences between configurations.

The files have the same configurations with the same measured values, and differ in
[material], [mesh] or [[parameters]].""",
        epilog=_COMPARE,
    )
    command.add_argument(
        "projects", metavar="PROJECT.toml", nargs="+", type=Path, help="project files"
    )
    cli.add_path(command, "--output", "DIR", "folder for the results")
    cli.add_output(command, force=cli.AGAIN)
    command.set_defaults(run=compare)


_TRANSFER = """\
examples:
  softcal transfer results_of_beam arm/project.toml

exit codes: 0 compared, whatever the verdict, 1 the calibration of B did not converge, 2
bad input
"""


def transfer(args: argparse.Namespace, show: cli.Display) -> None:
    from softcal_jax import report

    project = cli.load(args.project, show)
    with cli.bad_input():
        of_a = report.load_result(args.result).estimate
    project = replace(project, intervals=None)  # standard errors are compared
    show.now("first equilibrium")
    with cli.no_equilibrium("There is nothing to compare."):
        steps = cli.step_lines(project, show)
        result = project.calibrate(watch=cli.watch_lines(show, steps))
        if not result.converged:
            raise cli.Stop(cli.NOT_CONVERGED, "the calibration of B did not converge.")
        show.now("the poses of B with the values of A")
        transferred = report.transfer(of_a, project, result)
    show.line()
    show.line(str(transferred))
    show.document(transferred.as_dict())


def add_transfer(commands: "argparse._SubParsersAction") -> None:
    command = commands.add_parser(
        "transfer",
        help="do the values of one robot hold for another?",
        description="""\
Calibrates robot B and compares its material values with those calibrated on robot A. Do
they agree within their errors? In which direction do they differ? Do the values of A
predict the poses of B as well as the fit to B does? Parameters are matched by name;
parameters of the setup belong to each robot.""",
        epilog=_TRANSFER,
    )
    cli.add_path(command, "result", "RESULTS", "results folder of robot A")
    cli.add_path(command, "project", "PROJECT.toml", "the project file of robot B")
    cli.add_output(command)
    command.set_defaults(run=transfer)
