"""`softcal inverse` and `softcal export`: what a calibrated robot is used for."""

import argparse
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from softcal_jax.cli import _shared as cli
from softcal_jax.exchange.exporters import AbstractExporter, ExportProgress

if TYPE_CHECKING:
    from softcal_jax.fields import ParameterSpace

_RESULTS = "folder of the results, or result.json"
_MOVED = "the project file, if it was moved"

_INVERSE = """\
examples:
  softcal inverse results --configuration "20 kPa" --goal tip="(60, 8, 2) mm" -o command
  softcal inverse results --configuration pulled --goal wound="3 mm" -o command
  softcal inverse results --configuration "20 kPa" --goal tip="(-, -, 2) mm" \\
      --limit air="0 kPa to 45 kPa" --start air="10 kPa" -o command

RESULTS is the folder of softcal calibrate; project file, mesh and measurements must
be in the same place and unchanged. The configuration says what holds and loads the
robot, and which actuators are commanded: those in its `actuation`, as a start, from the
equilibrium that the calibration found there. A goal
is a value of a marker or effector, written as in the project file, and counts as met
within a hundredth of its `std`; measured values are not goals. A pose of a frame is an
inline table, --goal sensor='{ position = "(100, 10, 12) mm", azimuth = "10 deg" }'.

exit codes: 0 all goals are met, 1 some are not (the nearest point is written), or no
equilibrium, 2 bad input, 130 interrupted (the best actuation so far is written)
"""


def inverse(args: argparse.Namespace, show: cli.Display) -> None:
    cli.check_folder(args)
    from softcal_jax import results
    from softcal_jax.configurations import beyond
    from softcal_jax.control import OUTCOMES, ControlSettings, solve_inverse
    from softcal_jax.project import inverse_as_typed
    from softcal_jax.results import Made, headline

    cli.start_computing(show)
    show.now(f"reading {args.results}")
    with cli.bad_input():
        loaded = results.load_result(args.results, project=args.project)
        project = loaded.project
        _check_parameters(loaded.space)
        posed, _ = loaded.posed(args.configuration)
        guess = loaded.displacement(posed.name)
        posed, limits = inverse_as_typed(
            project,
            posed,
            goals=dict(_pairs("--goal", args.goal, 'tip="(100, 10, 12) mm"')),
            starts=dict(_pairs("--start", args.start, 'air="10 kPa"')),
            limits=_pairs("--limit", args.limit, 'air="0 kPa to 50 kPa"'),
        )
    show.lap("reading")
    commanded = ", ".join(posed.actuation) or "nothing"
    show.note(f"{project.name}, configuration {posed.name}: {commanded} is commanded")
    show.now("searching for the actuation")
    settings = ControlSettings(newton=project.newton)
    with cli.bad_input():
        result = solve_inverse(
            loaded.model,
            posed,
            limits=limits,
            settings=settings,
            guess=guess,
            throw=False,
        )
    show.lap("search")
    show.line()
    show.line(results.console(results.sections(result)))
    if further := beyond(project.calibration, result.configuration):
        show.line(f"The model is not tested there: {further}.")
    options = ["--configuration", posed.name]
    for flag in ("goal", "start", "limit"):
        for text in getattr(args, flag):
            options += [f"--{flag}", text]
    cli.write_results(
        result,
        args,
        show,
        name=project.name,
        made=Made(loaded.model, {"control": settings}, project.source),
        calibration=loaded.path,
        options=options,
        notes=(*cli.with_care(loaded.content), *show.warnings),
    )
    if not result.met:
        interrupted = result.outcome == OUTCOMES.interrupted
        code = cli.INTERRUPTED if interrupted else cli.NOT_CONVERGED
        raise cli.Stop(code, headline(result))


def _pairs(option: str, texts: Sequence[str], example: str) -> list[tuple[str, str]]:
    """Split texts like tip="(100, 10, 12) mm" at the first equals sign."""
    pairs = []
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        if not (name and value):
            raise ValueError(f"{option}: got {text!r}; expected {option} {example}.")
        if option != "--limit" and name in dict(pairs):
            raise ValueError(f"{option}: {name!r} is given twice; give it once.")
        pairs.append((name, value))
    return pairs


def _check_parameters(space: "ParameterSpace") -> None:
    """Raise if a calibrated value belongs to a configuration and not to the robot."""
    from softcal_jax.fields import KINDS, SetupParameter

    for entry in space.entries:
        if isinstance(entry, SetupParameter) and KINDS[entry.kind].of_configuration:
            raise ValueError(
                f"the calibrated {entry.noun} belongs to the configurations and not to "
                "the robot, so that its value is not known in the pose that is sought. "
                "Calibrate without it, or use softcal_jax.control in Python."
            )


def add_inverse(commands: "argparse._SubParsersAction") -> None:
    command = commands.add_parser(
        "inverse",
        help="the pressure, force or motor angle that brings the robot to a goal",
        description="Searches, with the calibrated model, for the actuation that "
        "brings markers or effectors to goals, or as close as the limits allow, and "
        "says what prevents a goal that is out of reach.",
        epilog=_INVERSE,
    )
    cli.add_path(command, "results", "RESULTS", _RESULTS)
    for flag, metavar, needed, text in (
        ("--goal", "NAME=VALUE", True, "a goal (repeat the option for several)"),
        ("--limit", "NAME=LOW to HIGH", False, "limits of an actuator"),
        ("--start", "NAME=VALUE", False, "command this actuator from this value"),
    ):
        more = {"required": True} if needed else {"default": []}
        command.add_argument(flag, metavar=metavar, action="append", help=text, **more)
    which = "the configuration (optional if there is only one)"
    command.add_argument("--configuration", metavar="NAME", help=which)
    cli.add_path(command, "--output", "DIR", "folder for the results", required=True)
    cli.add_path(command, "--project", "PROJECT.toml", _MOVED)
    cli.add_output(command, force=cli.AGAIN, pictures=True)
    command.set_defaults(run=inverse)


_EXPORT = """\
examples:
  softcal export inp results -o job.inp --configuration droop
  softcal export sofa results -o scene
  softcal export mujoco results -o model    a flex in MuJoCo, calibrated again for it
  softcal export icesl results -o print     graded foam, for the slicer IceSL
  softcal export icesl project.toml -o print   the start values: a designed field

RESULTS is the folder of softcal calibrate; project file, mesh and measurements must
be in the same place and unchanged.

exit codes: 0 written (differences are listed), 1 the calibration for SOFA or
MuJoCo did not converge, so that nothing was written, 2 bad input
"""


def add_export(
    commands: "argparse._SubParsersAction", exporters: Mapping[str, AbstractExporter]
) -> None:
    export = commands.add_parser(
        "export",
        help="write a calibrated model for another program",
        description="Writes a calibrated model as a file of another program.",
        epilog=_EXPORT,
    )
    formats = export.add_subparsers(required=True, metavar="FORMAT")
    for name, exporter in exporters.items():
        command = formats.add_parser(
            name,
            help=exporter.writes,
            description=exporter.description,
            epilog=f"Refused, with the reason: {exporter.cannot_hold}.",
        )
        cli.add_path(command, "results", "RESULTS", _RESULTS)
        cli.add_path(command, "--output", *exporter.output, required=True)
        cli.add_path(command, "--project", "PROJECT.toml", _MOVED)
        exporter.add_options(command)
        cli.add_output(command, force="replace what is there")
        command.set_defaults(run=partial(_export, exporter=exporter))


def _export(
    args: argparse.Namespace, show: cli.Display, *, exporter: AbstractExporter
) -> None:
    output: Path = args.output
    if exporter.output[0] == "DIR":
        cli.check_folder(args)
    else:
        cli.check_new(output, force=args.force)
    from softcal_jax.project import load_project
    from softcal_jax.results import load_result

    cli.start_computing(show)
    show.now(f"reading {args.results}")
    with cli.bad_input():
        if exporter.takes_projects and args.results.suffix == ".toml":
            source = project = load_project(args.results)
            care = []
        else:
            source = load_result(args.results, project=args.project)
            project = source.project
            care = cli.with_care(source.content)
    show.lap("reading")
    said: list[str] = []
    watch = cli.watch_lines(show, cli.step_lines(project, show))
    progress = ExportProgress(show.now, watch, said.append)
    with cli.no_equilibrium("Nothing was written."):
        notes = [*exporter.write(source, output, args, progress), *care]
    show.lap("export")
    for text in said:
        show.line()
        show.line(text)
    for note in notes:
        show.line(f"Note: {note}")
    more = f"; {exporter.next_step}" if exporter.next_step else ""
    show.line(f"Wrote {output}{more}.")
    computed = {"said": "\n".join(said)} if said else {}
    show.document({"output": str(output), **computed, "notes": notes})
    show.times()
