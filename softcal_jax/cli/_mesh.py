"""`softcal mesh`: from a CAD model to tets, and a picture of the groups."""

import argparse
from collections.abc import Callable
from importlib.metadata import version
from typing import TYPE_CHECKING

from softcal_jax.cli._shared import (
    BAD_INPUT,
    OK,
    Display,
    Stop,
    add_output,
    add_path,
    bad_input,
    check_new,
)
from softcal_jax.exchange.exporters import quantity

if TYPE_CHECKING:
    from softcal_jax.mesh import TetMesh

_UNIT = "mm"
"""Length unit of the mesh that is written."""

_MESH = """\
examples:
  softcal mesh finger.step -o finger.msh --size "3 mm"
  softcal mesh scan.stl -o scan.msh --length-unit mm
  softcal mesh project.toml -o finger.msh     the mesh and the groups of a project file

A project file needs no other table than [mesh] and, for names of your own, [groups]:

  [mesh]
  file = "finger.step"
  size = "3 mm"

  [groups.clamp]
  face = { points = ["(0, 5, 5) mm"] }

  [groups.chamber]
  inside = { point = "(30, 0, 0) mm", stop_at = "clamp" }   # where its inlet is

exit codes: 0 written, 2 bad input
"""


def mesh(args: argparse.Namespace, show: Display) -> int:
    """Write the mesh of a CAD model, a project or another mesh file, and draw it."""
    from softcal_jax.mesh import write_mesh
    from softcal_jax.plotting import plot_groups
    from softcal_jax.report import mesh_lines

    if args.output.suffix.lower() != ".msh":
        raise Stop(
            BAD_INPUT,
            f"error: {args.output} ends in {args.output.suffix!r}; expected a name that"
            " ends in .msh, like finger.msh.",
        )
    picture = args.output.with_suffix(f".{args.pictures}")
    written = [args.output] if args.no_pictures else [args.output, picture]
    check_new(*written, force=args.force)
    show.lap("import")
    show.now(f"meshing {args.model.name}")
    with bad_input():
        made = _made(args)
        show.lap("mesh")
        write_mesh(made, args.output, length_unit=_UNIT)
        if not args.no_pictures:
            show.now("drawing")
            plot_groups(made, picture, title=args.model.name)
            show.lap("picture")
    show.note(f"softcal {version('softcal-jax')}: {args.model.name}")
    for line in mesh_lines(made):
        show.line(line)
    drawn = "" if args.no_pictures else f", picture in {picture}"
    show.line(f"Mesh in {args.output} (Gmsh 2.2, linear, in {_UNIT}){drawn}.")
    show.document(
        {
            "nodes": made.n_nodes,
            "tets": made.n_tets,
            "surface_groups": list(made.surface_groups),
            "tet_groups": list(made.tet_groups),
            "node_groups": list(made.node_groups),
            "files": [str(path) for path in written],
        }
    )
    show.times()
    return OK


def _made(args: argparse.Namespace) -> "TetMesh":
    """Make or read the mesh."""
    from softcal_jax.exchange.cad import CAD_FORMATS, mesh_cad
    from softcal_jax.mesh import read_mesh
    from softcal_jax.project import load_mesh

    suffix = args.model.suffix.lower()
    if suffix != ".toml" and suffix not in CAD_FORMATS and args.length_unit is None:
        raise ValueError(
            f"{args.model}: the file does not state its unit; give it, like "
            "--length-unit mm."
        )
    if args.size is not None and suffix not in CAD_FORMATS:
        raise ValueError(
            f"--size is for CAD models ({', '.join(CAD_FORMATS)}), and {args.model} is "
            "none. Leave it out."
        )
    if suffix in CAD_FORMATS:
        size = None if args.size is None else quantity("--size", args.size, "m")
        return mesh_cad(args.model, size=size, length_unit=args.length_unit, order=1)
    if suffix != ".toml":
        return read_mesh(args.model, length_unit=args.length_unit)
    if args.length_unit is not None:
        raise ValueError(
            "--length-unit is for mesh and STL files; a project file states it in "
            "[mesh]. Leave it out."
        )
    return load_mesh(args.model)


def add_mesh(commands: "argparse._SubParsersAction", raw: Callable) -> None:
    """Add the command to the parser."""
    command = commands.add_parser(
        "mesh",
        help="from a CAD model to tets, with a picture of the groups",
        description="""\
Fills a CAD model (STEP or STL) with tets, names its faces, and draws them. With a
project file, it makes the mesh of [mesh] and draws the groups of [groups], so that they
are seen before anything is computed; with another mesh file, the groups of that.""",
        epilog=_MESH,
        formatter_class=raw,
    )
    add_path(command, "model", "MODEL", "CAD model, project file or mesh file")
    where = "the mesh; the picture is FILE.png beside it"
    add_path(command, "--output", "FILE.msh", where, required=True)
    size = 'edges of the tets, like "3 mm" (default: a thirtieth of the diagonal)'
    command.add_argument("--size", metavar="LENGTH", help=size)
    unit = "unit of an STL or mesh file: m, cm, mm, um or inch"
    command.add_argument("--length-unit", metavar="UNIT", help=unit)
    again = "replace earlier files"
    command.add_argument("--force", action="store_true", help=again)
    add_output(command, pictures=True)
    command.set_defaults(run=mesh)
