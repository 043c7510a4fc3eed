"""`softcal check`: what a project file says, in words and a picture, unsolved."""

import argparse
from collections.abc import Callable
from pathlib import Path
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
    load,
)

if TYPE_CHECKING:
    from softcal_jax.project import Project

_MARK = "softcal check"
"""Kept in the picture: an earlier one is replaced, a picture of anyone else is not."""

_CHECK = """\
examples:
  softcal check project.toml                  and project_check.png beside it
  softcal check project.toml -o setup.png
  softcal check project.toml --no-pictures

exit codes: 0 read, whatever it warns of, 2 bad input
"""


def check(args: argparse.Namespace, show: Display) -> int:
    """Say what a project file describes, and draw it; nothing is solved."""
    name = f"{args.project.stem}_check.{args.pictures}"
    picture = args.output or args.project.with_name(name)
    if picture.suffix.lower() not in (".png", ".svg"):
        raise Stop(
            BAD_INPUT,
            f"error: {picture} ends in {picture.suffix!r}; expected a picture, .png or "
            ".svg.",
        )
    if not args.no_pictures and not _is_own(picture):
        check_new(picture, force=args.force)
    project = load(args.project, show, solve=False)
    doubts = show.warnings
    from softcal_jax.project import quantities_as_read
    from softcal_jax.report import outline, roles_of

    above = ""
    if doubts:
        n = len(doubts)
        above = f", with the {'warning' if n == 1 else f'{n} warnings'} above"
    show.line(f"Nothing was solved; the project reads as follows{above}.")
    with bad_input():
        quantities = quantities_as_read(args.project)
        lines = list(outline(project, quantities))
        for line in lines:
            show.line(line)
        show.lap("outline")
        if not args.no_pictures:
            show.now("drawing", log=False)
            _draw(project, picture)
            show.lap("picture")
    show.line()
    if not args.no_pictures:
        show.line(f"Picture in {picture}.")
    show.document(
        {
            "name": project.name,
            "nodes": project.model.mesh.n_nodes,
            "tets": project.model.mesh.n_tets,
            "configurations": roles_of(project),
            "parameters": [q.name for q in project.parameters],
            "quantities": [
                {
                    "key": own.key,
                    "typed": own.typed,
                    "values": list(own.values),
                    "unit": own.unit,
                }
                for own in quantities
            ],
            "warnings": list(doubts),
            "outline": lines,
            "picture": None if args.no_pictures else str(picture),
        }
    )
    show.times()
    return OK


def _is_own(picture: Path) -> bool:
    """Whether a file is a picture of an earlier check."""
    if not picture.is_file():
        return False
    from PIL import Image, UnidentifiedImageError

    if picture.suffix.lower() == ".svg":
        return _MARK.encode() in picture.read_bytes()[:4000]
    try:
        with Image.open(picture) as image:
            return image.info.get("Software") == _MARK
    except (UnidentifiedImageError, OSError):
        return False


def _draw(project: "Project", picture: Path) -> None:
    """Draw every configuration, fitted ones first."""
    import numpy as np

    from softcal_jax.plotting import MOST_PANELS, plot_plan
    from softcal_jax.report import control_point_sets, roles_of

    posed = (*project.configurations, *project.candidates)
    left = len(posed) - MOST_PANELS
    more = f" {left} further configurations are not drawn." if left > 0 else ""
    sets = control_point_sets(project).values()
    points = [np.asarray(own.positions) for own in sets]
    roles = roles_of(project)
    plot_plan(
        project.model,
        {name: f"{name} ({role})" for name, role in roles.items()},
        posed,
        picture,
        title=project.name,
        subtitle=f"As the file describes it, at rest; nothing was solved.{more}",
        control_points=np.vstack(points) if points else None,
        software=_MARK,
    )


def add_check(commands: "argparse._SubParsersAction", raw: Callable) -> None:
    """Add the command to the parser."""
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
        formatter_class=raw,
    )
    add_path(command, "project", "PROJECT.toml", "the project file")
    where = "the picture, .png or .svg (default: PROJECT_check.png, beside the project)"
    add_path(command, "--output", "FILE", where)
    add_output(command, pictures=True)
    again = "replace a picture that is not of an earlier check"
    command.add_argument("--force", action="store_true", help=again)
    command.set_defaults(run=check)
