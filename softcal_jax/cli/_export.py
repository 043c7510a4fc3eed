"""`softcal export`: a calibrated model for another program."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from softcal_jax.cli._export_sofa import add_sofa
from softcal_jax.cli._shared import (
    BAD_INPUT,
    OK,
    Display,
    Stop,
    add_path,
    bad_input,
    start_computing,
)

if TYPE_CHECKING:
    from softcal_jax.report import LoadedResult

_EXAMPLES = """\
examples:
  softcal export inp results -o job.inp --configuration droop
  softcal export sofa results -o scene

RESULTS is the folder of softcal calibrate; project file, mesh and measurements must be
where and what they were.

exit codes: 0 written (what differs is said), 1 the calibration for SOFA did not
converge, so that nothing was written, 2 bad input
"""

Write = Callable[["LoadedResult", argparse.Namespace], Sequence[str]]
"""Writes an export to `args.output`; returns what to tell the user, in sentences."""


def _inp(result: "LoadedResult", args: argparse.Namespace) -> Sequence[str]:
    from softcal_jax.report import export_inp

    return export_inp(result, args.output, configuration=args.configuration)


def add_export(commands: "argparse._SubParsersAction", raw: Callable) -> None:
    """Add the group of commands to the parser, one for each format."""
    export = commands.add_parser(
        "export",
        help="write a calibrated model for another program",
        description="Writes a calibrated model as a file of another program.",
        epilog=_EXAMPLES,
        formatter_class=raw,
    )
    formats = export.add_subparsers(required=True, metavar="FORMAT")
    inp = _add_format(
        formats,
        "inp",
        _inp,
        help="an input file of CalculiX or Abaqus",
        description="Writes the calibrated model in one configuration as an input file "
        "of CalculiX or Abaqus: mesh, law, supports, loads and pressures, in SI.",
        output=("FILE.inp", "the file"),
    )
    _add_configuration(inp)
    add_sofa(formats)


def _add_format(
    formats: "argparse._SubParsersAction",
    name: str,
    write: Write,
    *,
    help: str,
    description: str,
    output: tuple[str, str],
) -> argparse.ArgumentParser:
    """Add a format; `output` are name and meaning of what is written."""
    command = formats.add_parser(name, help=help, description=description)
    add_path(command, "results", "RESULTS", "folder of the results, or result.json")
    add_path(command, "--output", *output, required=True)
    add_path(command, "--project", "PROJECT.toml", "the project file, if it was moved")
    again = "replace what is there"
    command.add_argument("--force", action="store_true", help=again)
    command.set_defaults(run=lambda args, show: _export(args, show, write))
    return command


def _add_configuration(command: argparse.ArgumentParser) -> None:
    which = "the configuration (may be left out if there is one)"
    command.add_argument("--configuration", metavar="NAME", help=which)


def _export(args: argparse.Namespace, show: Display, write: Write) -> int:
    """Load a result, and write it in a format."""
    output: Path = args.output
    if output.exists() and not args.force:
        raise Stop(
            BAD_INPUT,
            f"error: {output} exists already. Choose another name, or replace it with "
            "--force.",
        )
    if not output.parent.is_dir():
        raise Stop(
            BAD_INPUT,
            f"error: there is no folder {output.parent}. Make it, or choose another.",
        )
    from softcal_jax.report import load_result

    start_computing(show)
    show.now(f"reading {args.results}")
    with bad_input():
        result = load_result(args.results, project=args.project)
        show.lap("reading")
        notes = write(result, args)
    show.lap("writing")
    for note in notes:
        show.line(f"Note: {note}")
    show.line(f"Wrote {output}.")
    show.times()
    return OK
