"""`softcal check` and `softcal mesh`: what is seen before anything is solved."""

import argparse
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from softcal_jax.cli import _shared as cli
from softcal_jax.exchange.exporters import quantity

if TYPE_CHECKING:
    from softcal_jax.mesh import TetMesh
    from softcal_jax.project import Project

_MARK = "softcal check"  # in a picture of this command: the next run may replace it
_CHECK = """\
examples:
  softcal check project.toml                  and project_check.png beside it
  softcal check project.toml -o setup.png
  softcal check project.toml --no-pictures

exit codes: 0 read, whatever it warns of, 2 bad input
"""


def check(args: argparse.Namespace, show: cli.Display) -> None:
    from softcal_jax._files import check_file

    with cli.bad_input():
        check_file(args.project, "project file")
    name = f"{args.project.stem}_check.{args.pictures}"
    picture = args.output or args.project.with_name(name)
    cli.check_suffix(picture, ".png", ".svg", ".pdf")
    earlier = picture.is_file() and _MARK.encode() in picture.read_bytes()
    if not args.no_pictures and not earlier:
        cli.check_new(picture, force=args.force)
    project = cli.load(args.project, show, solve=False)
    doubts = show.warnings
    from softcal_jax.project import quantities_as_read
    from softcal_jax.results import roles_of, sections, text

    above = f" (warnings above: {len(doubts)})" if doubts else ""
    show.line(f"Nothing was solved. This is what the project describes{above}:")
    with cli.bad_input():
        quantities = quantities_as_read(args.project)
        described = filter(None, sections(project, quantities))
        words = "\n\n".join(text([section]) for section in described)
        show.line(f"\n{words}")
        show.lap("outline")
        if not args.no_pictures:
            show.now("drawing", log=False)
            _draw(project, picture)
            show.lap("picture")
    show.line()
    if not args.no_pictures:
        show.line(f"Picture: {picture}")
    show.document(
        {
            "name": project.name,
            "nodes": project.model.mesh.n_nodes,
            "tets": project.model.mesh.n_tets,
            "configurations": roles_of(project),
            "parameters": [q.name for q in project.parameters],
            "quantities": [read._asdict() for read in quantities],
            "warnings": list(doubts),
            "outline": words.splitlines(),
            "picture": None if args.no_pictures else str(picture),
        }
    )
    show.times()


def _draw(project: "Project", picture: Path) -> None:
    """Draw every configuration, fitted ones first."""
    import numpy as np

    from softcal_jax.plotting import MOST_PANELS, plot_plan
    from softcal_jax.results import control_point_sets, roles_of

    posed = (*project.configurations, *project.candidates)
    left = len(posed) - MOST_PANELS
    more = f" {left} further configurations are not drawn." if left > 0 else ""
    sets = control_point_sets(project).values()
    points = [np.asarray(layout.positions) for layout in sets]
    plot_plan(
        project.model,
        {name: f"{name} ({role})" for name, role in roles_of(project).items()},
        posed,
        picture,
        title=project.name,
        subtitle=f"As the file describes it, at rest; nothing was solved.{more}",
        control_points=np.vstack(points) if points else None,
        software=_MARK,
    )


def add_check(commands: "argparse._SubParsersAction") -> None:
    command = commands.add_parser(
        "check",
        help="what a project file says, in words and a picture, before any solve",
        description="""\
Reads a project file, checks it as the other commands do, and says what it describes:
mesh and unknowns, loads against the weight, where markers and control points stand,
configurations and what is measured in them, parameters with bounds and priors, every
quantity as it was typed and as it was read, and which commands would run. The picture
shows supports, loads, gravity, actuators, rigid bodies and markers of each
configuration. Nothing is solved, so it takes seconds.""",
        epilog=_CHECK,
    )
    cli.add_path(command, "project", "PROJECT.toml", "the project file")
    where = "the picture, .png, .svg or .pdf (default: PROJECT_check.png, beside it)"
    cli.add_path(command, "--output", "FILE", where)
    again = "replace a picture that softcal check did not draw"
    cli.add_output(command, force=again, pictures=True)
    command.set_defaults(run=check)


_UNIT = "mm"  # of the mesh that is written
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
"""


def mesh(args: argparse.Namespace, show: cli.Display) -> None:
    from softcal_jax.mesh import write_mesh
    from softcal_jax.plotting import plot_groups
    from softcal_jax.results import sections, text

    cli.check_suffix(args.output, ".msh")
    picture = args.output.with_suffix(f".{args.pictures}")
    written = [args.output] if args.no_pictures else [args.output, picture]
    cli.check_new(*written, force=args.force)
    show.lap("import")
    show.now(f"meshing {args.model.name}")
    with cli.bad_input():
        made = _made(args)
        show.lap("mesh")
        write_mesh(made, args.output, length_unit=_UNIT)
        if not args.no_pictures:
            show.now("drawing")
            plot_groups(made, picture, title=args.model.name)
            show.lap("picture")
    show.note(f"softcal {version('softcal-jax')}: {args.model.name}")
    show.line(text(sections(made)))
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


def _made(args: argparse.Namespace) -> "TetMesh":
    from softcal_jax._files import check_file
    from softcal_jax.exchange.cad import CAD_FORMATS, mesh_cad
    from softcal_jax.mesh import read_mesh
    from softcal_jax.project import load_mesh

    check_file(args.model, "model")
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


def add_mesh(commands: "argparse._SubParsersAction") -> None:
    command = commands.add_parser(
        "mesh",
        help="from a CAD model to tets, with a picture of the groups",
        description="""\
Meshes a CAD model (STEP or STL) with tets, names its faces, and draws them. With a
project file, it makes the mesh of [mesh] and draws the groups of [groups] before
anything is computed; with a mesh file, it draws the groups of that file.""",
        epilog=_MESH,
    )
    cli.add_path(command, "model", "MODEL", "CAD model, project file or mesh file")
    where = "the mesh; the picture is FILE.png beside it"
    cli.add_path(command, "--output", "FILE.msh", where, required=True)
    size = 'edges of the tets, like "3 mm" (default: a thirtieth of the diagonal)'
    command.add_argument("--size", metavar="LENGTH", help=size)
    unit = "unit of an STL or mesh file: m, cm, mm, um or inch"
    command.add_argument("--length-unit", metavar="UNIT", help=unit)
    cli.add_output(command, force="replace earlier files", pictures=True)
    command.set_defaults(run=mesh)
