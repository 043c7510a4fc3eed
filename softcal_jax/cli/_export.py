"""`softcal export`: a calibrated model for another program."""

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from softcal_jax.cli._shared import (
    BAD_INPUT,
    OK,
    Display,
    Stop,
    add_output,
    add_path,
    bad_input,
    check_folder,
    check_new,
    no_equilibrium,
    start_computing,
    with_care,
)
from softcal_jax.cli._steps import step_lines
from softcal_jax.exchange.exporters import AbstractExporter, ExportProgress

_EXAMPLES = """\
examples:
  softcal export inp results -o job.inp --configuration droop
  softcal export sofa results -o scene
  softcal export icesl results -o print     graded foam, for the slicer IceSL
  softcal export icesl project.toml -o print   the start values: a designed field

RESULTS is the folder of softcal calibrate; project file, mesh and measurements must be
where and what they were.

exit codes: 0 written (what differs is said), 1 the calibration for SOFA did not
converge, so that nothing was written, 2 bad input
"""


def add_export(
    commands: "argparse._SubParsersAction",
    raw: Callable,
    exporters: Mapping[str, AbstractExporter],
) -> None:
    """Add the group of commands to the parser, one for each exporter."""
    export = commands.add_parser(
        "export",
        help="write a calibrated model for another program",
        description="Writes a calibrated model as a file of another program.",
        epilog=_EXAMPLES,
        formatter_class=raw,
    )
    formats = export.add_subparsers(required=True, metavar="FORMAT")
    for name, exporter in exporters.items():
        command = formats.add_parser(
            name,
            help=exporter.writes,
            description=exporter.description,
            epilog=f"Refused, with the reason: {exporter.cannot_hold}.",
        )
        add_path(command, "results", "RESULTS", "folder of the results, or result.json")
        add_path(command, "--output", *exporter.output, required=True)
        text = "the project file, if it was moved"
        add_path(command, "--project", "PROJECT.toml", text)
        exporter.add_options(command)
        add_output(command, force="replace what is there")
        command.set_defaults(run=partial(_export, exporter=exporter))


def _export(
    args: argparse.Namespace, show: Display, *, exporter: AbstractExporter
) -> int:
    """Load a result, and write it in a format."""
    output: Path = args.output
    if exporter.output[0] == "DIR":
        check_folder(args)
    else:
        check_new(output, force=args.force)
        if not output.parent.is_dir():
            text = f"there is no folder {output.parent}. Make it, or choose another."
            raise Stop(BAD_INPUT, f"error: {text}")
    from softcal_jax.project import load_project
    from softcal_jax.report import load_result

    start_computing(show)
    show.now(f"reading {args.results}")
    with bad_input():
        if exporter.takes_projects and args.results.suffix == ".toml":
            source = project = load_project(args.results)
            doubts = ()
        else:
            source = load_result(args.results, project=args.project)
            project, doubts = source.project, source.doubts
    show.lap("reading")
    said: list[str] = []
    progress = ExportProgress(show.now, step_lines(project, show), said.append)
    with bad_input(), no_equilibrium("Nothing was written."):
        notes = [*exporter.write(source, output, args, progress), *with_care(doubts)]
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
    return OK
