"""`softcal inverse`: the actuation that brings a calibrated robot to a goal."""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from softcal_jax.cli._shared import (
    NOT_CONVERGED,
    OK,
    Display,
    Stop,
    add_output,
    add_path,
    bad_input,
    check_folder,
    start_computing,
    with_care,
)
from softcal_jax.cli._steps import pictures_with_a_bar, write_results

if TYPE_CHECKING:
    from softcal_jax.fields import ParameterSpace

_INVERSE = """\
examples:
  softcal inverse results --configuration "20 kPa" --goal tip="(60, 8, 2) mm" -o command
  softcal inverse results --configuration pulled --goal wound="3 mm" -o command
  softcal inverse results --configuration "20 kPa" --goal tip="(-, -, 2) mm" \\
      --limit air="0 kPa to 45 kPa" --start air="10 kPa" -o command

RESULTS is the folder of softcal calibrate; project file, mesh and measurements must be
where and what they were. The configuration says what holds and loads the robot, and
which actuators are commanded: those in its `actuation`, from there on. A goal is a
value of a marker or of an effector, in the words of the project file, and counts as met
within a hundredth of its `std`; what was measured is no goal. A pose of a frame is an
inline table, --goal sensor='{ position = "(100, 10, 12) mm", azimuth = "10 deg" }'.

exit codes: 0 all goals are met, 1 some are not (the nearest point is written), or no
equilibrium, 2 bad input
"""


def inverse(args: argparse.Namespace, show: Display) -> int:
    """Search for the actuation that meets the goals, and write it."""
    check_folder(args)
    from softcal_jax import report
    from softcal_jax.control import ControlSettings, solve_inverse
    from softcal_jax.export import Made
    from softcal_jax.project import (
        actuation_as_typed,
        limits_as_typed,
        with_goals_as_typed,
    )

    start_computing(show)
    show.now(f"reading {args.results}")
    with bad_input():
        loaded = report.load_result(args.results, project=args.project)
        project = loaded.project
        _check_parameters(loaded.space)
        posed, _ = loaded.posed(args.configuration)
        goals = dict(_pairs("--goal", args.goal, 'tip="(100, 10, 12) mm"'))
        starts = dict(_pairs("--start", args.start, 'air="10 kPa"'))
        ranges = _pairs("--limit", args.limit, 'air="0 kPa to 50 kPa"')
        limits = limits_as_typed(project, ranges)
        posed = with_goals_as_typed(project, posed, goals)
        asked = {**posed.actuation, **actuation_as_typed(project, starts)}
        posed = replace(posed, actuation=asked)
    show.lap("reading")
    commanded = ", ".join(posed.actuation) or "nothing"
    show.note(f"{project.name}, configuration {posed.name}: {commanded} is commanded")
    show.now("searching for the actuation")
    settings = ControlSettings(newton=project.newton)
    with bad_input():
        found = solve_inverse(
            loaded.model, posed, limits=limits, settings=settings, throw=False
        )
    show.lap("search")
    show.line()
    show.line(report.inverse_table(found))

    def write(where: Path, force: bool) -> Path:
        options = ["--configuration", posed.name]
        for flag in ("goal", "start", "limit"):
            for text in getattr(args, flag):
                options += [f"--{flag}", text]
        return report.write_inverse(
            found,
            where,
            name=project.name,
            force=force,
            timing_s=dict(show.laps),
            made=Made(loaded.model, {"control": settings}, project.source),
            calibration=loaded.path,
            options=options,
            notes=(*with_care(loaded.doubts), *show.warnings),
            **pictures_with_a_bar(args, show),
        )

    write_results(write, args, show, index="inverse.json", force=args.force)
    if not found.met:
        raise Stop(NOT_CONVERGED, found.message)
    return OK


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
    """Raise if a calibrated value belongs to a configuration, which is solved anew."""
    from softcal_jax.fields import SetupParameter

    for entry in space.entries:
        if isinstance(entry, SetupParameter) and entry.quantity.of_configuration:
            raise ValueError(
                f"the calibrated {entry.noun} belongs to the configurations and not to "
                "the robot, and a command to a goal cannot say which it has then. "
                "Calibrate without it, or use softcal_jax.control in Python."
            )


def add_inverse(commands: "argparse._SubParsersAction", raw: Callable) -> None:
    """Add the command to the parser."""
    command = commands.add_parser(
        "inverse",
        help="the pressure, force or motor angle that brings the robot to a goal",
        description="Searches, with the calibrated model, for the actuation that "
        "brings markers or effectors to goals, or as near as the limits let it, and "
        "says what holds it where a goal is out of reach.",
        epilog=_INVERSE,
        formatter_class=raw,
    )
    add_path(command, "results", "RESULTS", "folder of the results, or result.json")
    for flag, metavar, needed, text in (
        ("--goal", "NAME=VALUE", True, "a goal (several times for several)"),
        ("--limit", "NAME=LOW to HIGH", False, "limits of an actuator"),
        ("--start", "NAME=VALUE", False, "command this actuator, from this value on"),
    ):
        more = {"required": True} if needed else {"default": []}
        command.add_argument(flag, metavar=metavar, action="append", help=text, **more)
    which = "the configuration (may be left out if there is one)"
    command.add_argument("--configuration", metavar="NAME", help=which)
    add_path(command, "--output", "DIR", "folder for the results", required=True)
    add_path(command, "--project", "PROJECT.toml", "the project file, if it was moved")
    add_output(command, force="replace earlier results in that folder", pictures=True)
    command.set_defaults(run=inverse)
