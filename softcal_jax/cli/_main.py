"""Arguments of the command line, and the end of every command."""

import argparse
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from rich.console import Console

from softcal_jax.cli._commands import INTERRUPTED, Stop, calibrate, demo, simulate
from softcal_jax.cli._display import Display, process_start, warnings_as_lines

_ABOUT = """\
Calibrate the finite-element model of a soft robot from a few measured poses."""

_EXAMPLES = """\
examples:
  softcal demo                            calibrate a real silicone beam
  softcal demo --write my_robot           its project file and data, to start from
  softcal calibrate my_robot/project.toml -o results
  softcal simulate my_robot/project.toml -o forward

exit codes: 0 all is well, 1 not converged or no equilibrium, 2 bad input
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        argv: Arguments after the program's name; those of the process by default.

    Returns:
        The exit code: 0 all is well, 1 not converged or no equilibrium, 2 bad input,
        130 interrupted.
    """
    begin = process_start() if argv is None else time.time()
    args = _parser().parse_args(argv)
    display = Display(begin)
    try:
        with display:
            display.now("importing", log=False)
            with warnings_as_lines(display):
                return args.run(args, display)
    except Stop as stop:
        text, code = str(stop), stop.code
    except KeyboardInterrupt:
        text, code = "interrupted; nothing was written.", INTERRUPTED
    errors = Console(stderr=True)
    errors.print(text, markup=False, highlight=False, soft_wrap=True)
    return code


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        "softcal", description=_ABOUT, epilog=_EXAMPLES, formatter_class=raw
    )
    parser.add_argument(
        "--version", action="version", version=f"softcal {version('softcal-jax')}"
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    beam = commands.add_parser(
        "demo",
        help="calibrate a real silicone beam from its motion capture",
        description="Fits Young's modulus of a clamped silicone beam to two measured "
        "loads, predicts a third, and writes the results.",
    )
    _add_output(beam, default="demo_results")
    beam.add_argument(
        "--write",
        metavar="DIR",
        type=Path,
        help="write the demo's project file and data to DIR and stop",
    )
    beam.set_defaults(run=demo)

    fit = commands.add_parser(
        "calibrate",
        help="fit the parameters of a project file",
        description="Fits the parameters of a project file to its measured "
        "configurations, predicts those held out, and writes the results.",
    )
    fit.set_defaults(run=lambda args, show: calibrate(args, show, args.project))
    forward = commands.add_parser(
        "simulate",
        help="solve the configurations of a project file, without a fit",
        description="Solves the equilibrium of every configuration of a project file "
        "with the start values of its parameters, and writes the results.",
    )
    forward.set_defaults(run=simulate)
    for command in (fit, forward):
        command.add_argument(
            "project", metavar="PROJECT.toml", type=Path, help="the project file"
        )
        _add_output(command, default=None)
    return parser


def _add_output(parser: argparse.ArgumentParser, *, default: str | None) -> None:
    parser.add_argument(
        "-o",
        "--output",
        metavar="DIR",
        type=Path,
        default=default and Path(default),
        required=default is None,
        help="folder for the results" + (f" (default: {default})" if default else ""),
    )
    parser.add_argument(
        "--force", action="store_true", help="replace earlier results in that folder"
    )
