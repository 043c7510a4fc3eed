"""`softcal export`: a calibrated model for another program."""

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softcal_jax.cli._export_sofa import add_sofa
from softcal_jax.cli._shared import (
    BAD_INPUT,
    OK,
    Display,
    Stop,
    add_output,
    add_path,
    bad_input,
    check_new,
    quantity,
    start_computing,
    with_care,
)

if TYPE_CHECKING:
    from softcal_jax.project import Project
    from softcal_jax.report import LoadedResult

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

Write = Callable[[Any, argparse.Namespace], Sequence[str]]
"""Writes a result or a project to `args.output`; returns what to tell, in sentences."""


def _inp(result: "LoadedResult", args: argparse.Namespace) -> Sequence[str]:
    from softcal_jax.exchange.inp import export_inp

    return export_inp(result, args.output, configuration=args.configuration)


def _icesl(result: "LoadedResult | Project", args: argparse.Namespace) -> Sequence[str]:
    from softcal_jax.exchange.icesl import export_icesl
    from softcal_jax.materials import published_foam

    if args.table is not None and args.solid_modulus is not None:
        raise ValueError(
            "--solid-modulus scales the published table; a table of your own, --table, "
            "has the moduli of your foam already. Give one of the two."
        )
    table = args.table
    if args.solid_modulus is not None:
        modulus = quantity("--solid-modulus", args.solid_modulus, "Pa")
        table = published_foam(modulus)
    written = export_icesl(
        result,
        args.output,
        infill=args.infill.capitalize(),
        table=table,
        plane=args.plane,
        region=args.region,
        angle_marks=args.angle_marks,
        angle_offset=quantity("--angle-offset", args.angle_offset, "rad"),
        clockwise=args.clockwise,
        force=args.force,
    )
    return written.notes


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
    icesl = _add_format(
        formats,
        "icesl",
        _icesl,
        help="graded foam for the slicer IceSL",
        description="Writes the part as STL and a script for IceSL with density, angle "
        "and anisotropy of a foam that has the calibrated moduli E_t, E_l and the "
        "fibre. What the foam does not reach is listed with its place. RESULTS may be "
        "a project file, of which the start values are taken.",
        output=("DIR", "the folder"),
        designed=True,
    )
    _add_foam(icesl)


def _add_foam(command: argparse.ArgumentParser) -> None:
    """Add the options of a printed foam."""
    add = command.add_argument
    add(
        "--infill",
        choices=["polyfoam", "phasor"],
        default="polyfoam",
        help="foam with a soft axis (default), or with a stiff one, which needs "
        "--table",
    )
    text = "moduli of the foam: columns density, shrink or iso, E_soft_kPa, E_stiff_kPa"
    add_path(command, "--table", "FILE.csv", f"{text} (default: as published, of TPU)")
    text = "Young's modulus of the solid, for the published table (default: 12 MPa)"
    add("--solid-modulus", metavar="MODULUS", help=text)
    text = "axes of the mesh along x and y of the print bed (default: those of theta)"
    add("--plane", choices=["xy", "xz", "yz"], help=text)
    add("--region", metavar="NAME", help="tet group that is printed (default: all)")
    text = "axis of the foam that the angle marks (default: soft; stiff for phasor)"
    add("--angle-marks", choices=["soft", "stiff"], help=text)
    text = 'added to every angle, like "90 deg"'
    add("--angle-offset", metavar="ANGLE", default="0 deg", help=text)
    add("--clockwise", action="store_true", help="the slicer counts angles clockwise")


def _add_format(
    formats: "argparse._SubParsersAction",
    name: str,
    write: Write,
    *,
    help: str,
    description: str,
    output: tuple[str, str],
    designed: bool = False,
) -> argparse.ArgumentParser:
    """Add a format.

    `output` are name and meaning of what is written; `designed` says whether a project
    file may stand for a result, with its start values.
    """
    command = formats.add_parser(name, help=help, description=description)
    add_path(command, "results", "RESULTS", "folder of the results, or result.json")
    add_path(command, "--output", *output, required=True)
    add_path(command, "--project", "PROJECT.toml", "the project file, if it was moved")
    again = "replace what is there"
    command.add_argument("--force", action="store_true", help=again)
    add_output(command)
    run = partial(_export, write=write, designed=designed)
    command.set_defaults(run=run)
    return command


def _add_configuration(command: argparse.ArgumentParser) -> None:
    which = "the configuration (may be left out if there is one)"
    command.add_argument("--configuration", metavar="NAME", help=which)


def _export(
    args: argparse.Namespace, show: Display, *, write: Write, designed: bool
) -> int:
    """Load a result, and write it in a format."""
    output: Path = args.output
    check_new(output, force=args.force)
    if not output.parent.is_dir():
        raise Stop(
            BAD_INPUT,
            f"error: there is no folder {output.parent}. Make it, or choose another.",
        )
    from softcal_jax.project import load_project
    from softcal_jax.report import load_result

    start_computing(show)
    show.now(f"reading {args.results}")
    doubts: tuple[str, ...] = ()
    with bad_input():
        if designed and args.results.suffix == ".toml":
            result = load_project(args.results)
        else:
            result = load_result(args.results, project=args.project)
            doubts = result.doubts
        show.lap("reading")
        notes = write(result, args)
    show.lap("writing")
    notes = [*notes, *with_care(doubts)]
    for note in notes:
        show.line(f"Note: {note}")
    show.line(f"Wrote {output}.")
    show.document({"output": str(output), "notes": notes})
    show.times()
    return OK
