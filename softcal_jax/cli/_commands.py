"""The commands; heavy packages are imported only when one runs."""

import argparse
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softcal_jax.cli import _shared as cli

if TYPE_CHECKING:
    from softcal_jax.calibration import CalibrationResult
    from softcal_jax.configurations import Configuration
    from softcal_jax.project import Project
    from softcal_jax.results import Made


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
    from softcal_jax import results
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
    tree = results.sections(result, assessment)
    show.line(results.console(tree, short=not args.verbose))
    about = {"name": project.name, "traces": project.traces, "known": assessment}
    cli.write_results(result, args, show, **about)
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
    from softcal_jax import results
    from softcal_jax._process import Clock
    from softcal_jax.equilibrium import check_converged

    project = cli.load(args.project, show)
    show.now(f"equilibrium of {_names(project.configurations)}")
    progress = cli.equilibrium_lines(show)
    with Clock() as clock, cli.bad_input():
        values = args.values and results.load_values(args.values)
        result, solution = project.simulate(values, progress=progress)
    if values is not None:
        names = ", ".join(q.name for q in project.parameters)
        show.note(f"values of {args.values}: {names}")
    show.lap("solve", compiling=clock.seconds["compile"])
    show.line()
    show.line(results.console(results.sections(result)))
    cli.write_results(
        result,
        args,
        show,
        name=project.name,
        traces=project.traces,
        made=_made(project),
        calibration=args.values and results.result_path(args.values),
    )
    # Who has no equilibrium is named once the results are written.
    with cli.no_equilibrium("The results contain the others, if any."):
        check_converged(solution, tuple(c.name for c in project.configurations))


def design(args: argparse.Namespace, show: cli.Display) -> None:
    cli.check_folder(args)
    from softcal_jax import results
    from softcal_jax.exchange.icesl import Design, export_icesl
    from softcal_jax.results import headline

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
    show.line(results.console(results.sections(result)))
    about = {"name": project.name, "project": project}
    cli.write_results(result, args, show, **about)
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
    result: Any = outlook or ranking
    made = _made(project, precision=project.precision)
    about = {"name": project.name, "made": made, "known": outlook and ranking}
    cli.write_results(result, args, show, **about)


def _made(project: "Project", **settings: Any) -> "Made":
    """Collect what a project was solved with: model, `settings`, and its file."""
    from softcal_jax.results import Made

    return Made(project.model, {**settings, "newton": project.newton}, project.source)


def _names(group: "Sequence[Configuration]") -> str:
    return ", ".join(c.name for c in group)


_DESIGN = """\
examples:
  softcal design project.toml -o design
  softcal calibrate design/project.toml -o results   once poses of the print are in it

A configuration has a goal in place of `measured`, and [design] says what limits it:
  goal = { tip = "(100, -, 12) mm" }
  [design]
  foam = "Polyfoam"
  limits = { cable = "0 N to 5 N" }

exit codes: 0 all goals and limits met, 1 some not, or no equilibrium, 2 bad input
"""

_IDENTIFY = """\
examples:
  softcal identify project.toml
  softcal identify project.toml -o outlook    and as identifiability.json and .txt

exit codes: 0 assessed, whatever the verdict, 1 no equilibrium, 2 bad input
"""


def add_project_commands(commands: "argparse._SubParsersAction") -> None:
    """Add demo, calibrate, simulate, design and identify."""
    beam = commands.add_parser(
        "demo",
        help="calibrate a real robot from its motion capture",
        description="Calibrates a real robot from measured poses, predicts held-out "
        "poses, and writes the results. beam: Young's modulus of a clamped "
        "silicone beam, from two loads; under a minute. arm: matrix and fibres of a "
        "pneumatic arm, from three pressures; many minutes, and it needs "
        "softcal-jax[mocap].",
    )
    text, robots = "which robot (default: beam)", ["beam", "arm"]
    beam.add_argument("robot", nargs="?", choices=robots, default="beam", help=text)
    where = "folder for the results"
    cli.add_path(beam, "--output", "DIR", f"{where} (default: demo_results)")
    text = "write the demo's project file and data to DIR and stop"
    cli.add_path(beam, "--write", "DIR", text)
    beam.set_defaults(run=demo, checkpoint=None, output=Path("demo_results"))

    fit = commands.add_parser(
        "calibrate",
        help="fit the parameters of a project file",
        description="Fits the parameters of a project file to its measured "
        "configurations, predicts those held out, and writes the results.",
    )
    text = "save the state to FILE after every step; resume from FILE if it exists"
    cli.add_path(fit, "--checkpoint", "FILE", text)
    fit.set_defaults(run=calibrate)
    forward = commands.add_parser(
        "simulate",
        help="solve the configurations of a project file, without a fit",
        description="Solves the equilibrium of every configuration of a project file "
        "with the start values of its parameters, or with values that were calibrated, "
        "and writes the results. It reports the error of each measured pose.",
    )
    text = "use the values in this results folder of softcal calibrate, by name"
    cli.add_path(forward, "--values", "RESULTS", text)
    forward.set_defaults(run=simulate)
    plan = commands.add_parser(
        "design",
        help="find the material and the actuation that meet goals",
        description="Finds the fields of the material, and for each goal the "
        "actuation, that bring markers and effectors to the goals of a project file, "
        "within what can be printed; says what each goal comes to as printed, and what "
        "holds a missed one; and writes a project for the printed robot.",
        epilog=_DESIGN,
    )
    plan.set_defaults(run=design)
    outlook = commands.add_parser(
        "identify",
        help="would the data determine the parameters? ask before measuring",
        description="""\
Solves the configurations of a project file at the start values and says whether their
markers and other effectors would determine the parameters: a verdict for each, the
directions that the data are blind to, and condition numbers. A verdict compares the
standard error with its target, `precision` under [settings]: 10 % by default.

No measured positions are needed, and any that are given are ignored. Only the `std` of
markers and effectors and the axes of the markers count.

Candidates are ranked by what measuring them would add: those of the project file,
[[candidates]] with the keys of [[configurations]], and proposals (gravity along other
axes, the other end held, a weight at the tip, half and full actuation, the same again).
It then says which fewest of them reach the target, or what else would. The candidates
take about as long as as many configurations; the verdict stands before.""",
        epilog=_IDENTIFY,
    )
    text = 'the target, in place of `precision`: --aim "5 %%"'
    outlook.add_argument("--aim", metavar="ERROR", help=text)
    outlook.set_defaults(run=identify)
    for command in (fit, forward, plan, outlook):
        cli.add_path(command, "project", "PROJECT.toml", "the project file")
        needed = command is not outlook
        cli.add_path(command, "--output", "DIR", where, required=needed)
    for command in (beam, fit):
        text = "also print the tables of the report"
        command.add_argument("--verbose", "-v", action="store_true", help=text)
    for command in (beam, fit, forward, plan, outlook):
        cli.add_output(command, force=cli.AGAIN, pictures=command is not outlook)


_COMPARE = """\
examples:
  softcal compare neo_hookean.toml yeoh.toml gent.toml
  softcal compare coarse.toml fine.toml -o compared   and as comparison.json and .txt

exit codes: 0 compared, whatever the verdict, 1 no model predicts every configuration,
2 bad input
"""


def compare(args: argparse.Namespace, show: cli.Display) -> None:
    cli.check_folder(args)
    from softcal_jax.project import compare_projects, projects_by_name

    projects = [cli.load(path, show) for path in args.projects]
    n = sum(len(project.calibration) + 1 for project in projects)
    show.note(f"{n} fits, each to all configurations or to all but one")
    with cli.no_equilibrium("Nothing was written."):
        comparison = compare_projects(projects, progress=show.now)
    show.lap("solve")
    named = projects_by_name(projects).items()
    made = {name: _made(project) for name, project in named}
    show.line()
    show.line(str(comparison))
    cli.write_results(comparison, args, show, made=made)
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
    from softcal_jax import results

    project = cli.load(args.project, show)
    with cli.bad_input():
        of_a = results.load_result(args.result).estimate
    project = replace(project, intervals=None)  # standard errors are compared
    show.now("first equilibrium")
    with cli.no_equilibrium("There is nothing to compare."):
        steps = cli.step_lines(project, show)
        result = project.calibrate(watch=cli.watch_lines(show, steps))
        if not result.converged:
            raise cli.Stop(cli.NOT_CONVERGED, "the calibration of B did not converge.")
        show.now("the poses of B with the values of A")
        transferred = results.transfer(of_a, project, result)
    show.line()
    show.line(str(transferred))
    verdict = results.headline(transferred)
    show.document({**results.plain(transferred), "verdict": verdict})


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
