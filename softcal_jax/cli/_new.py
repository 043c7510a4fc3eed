"""`softcal new` and `softcal tags`: what a measurement begins with."""

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from softcal_jax.cli import _shared as cli
from softcal_jax.cli._display import Display
from softcal_jax.exchange.exporters import quantity

if TYPE_CHECKING:
    from softcal_jax.exchange.proposal import Findings

_NEW = """\
examples:
  softcal new finger --robot pneumatic-finger
  softcal new finger --model finger.step --size "3 mm" --markers poses.csv
  softcal new arm --model arm.msh --length-unit mm --markers 100mbar.c3d 200mbar.c3d
"""


def new(args: argparse.Namespace, show: Display) -> None:
    from softcal_jax.project import guesses_left

    with cli.bad_input():
        run = _proposed if args.robot is None else _ready_made
        measured = run(args, show)
    show.note("Next:")
    project = args.folder / "project.toml"
    show.note(f"  softcal check {project}")
    show.note(f"  softcal identify {project}")
    if measured:
        show.note(f"  softcal calibrate {project} -o {args.folder / 'results'}")
    show.document(
        {
            "project": str(project),
            "files": sorted(str(path) for path in args.folder.iterdir()),
            "guesses": [guess._asdict() for guess in guesses_left(project)],
            "measured": measured,
        }
    )


def _ready_made(args: argparse.Namespace, show: Display) -> bool:
    """Copy a ready-made robot, say what it is, and return True: all have readings."""
    from softcal_jax.exchange.proposal import write_ready_made

    for option in ("markers", "size", "length_unit"):
        if getattr(args, option):
            raise ValueError(
                f"--{option.replace('_', '-')} is for a model of your own; a "
                "ready-made robot is complete. Leave it out."
            )
    files = write_ready_made(args.robot, args.folder)
    show.line(f"Wrote {', '.join(files)} to {args.folder}.")
    readme = (args.folder / "README.md").read_text(encoding="utf-8")
    show.line(readme.splitlines()[0].removeprefix("# ") + ": see README.md there.")
    return True


def _proposed(args: argparse.Namespace, show: Display) -> bool:
    """Write a project for a model; returns whether it has readings to calibrate to."""
    from softcal_jax.exchange.proposal import propose_project
    from softcal_jax.project import CHANGE, guesses_left

    cli.start_computing(show)
    show.now(f"reading {args.model.name}")
    findings = propose_project(
        args.model,
        args.folder,
        recordings=args.markers,
        size=None if args.size is None else quantity("--size", args.size, "m"),
        length_unit=args.length_unit,
    )
    files = sorted(path.name for path in args.folder.iterdir())
    show.line(f"Wrote {', '.join(files)} to {args.folder}.")
    show.line("\n".join(_finding_lines(findings)))
    many = len(guesses_left(args.folder / "project.toml"))
    show.line(
        f'{many} lines hold a guess; a remark "{CHANGE}..." on each says what to '
        "change or confirm. `softcal check` lists them."
    )
    return findings.recorded is not None and not findings.own_frame


def _finding_lines(findings: "Findings") -> Iterator[str]:
    import numpy as np

    from softcal_jax._units import readable_values

    body, recorded = findings.body, findings.recorded
    sides = readable_values(np.ptp(body.mesh.points, axis=0).tolist(), "m")
    unit = f", if its unit is {body.unit}" if body.unit_guessed else ""
    yield f"Body: {sides}{unit}; {body.mesh.n_tets} tets."
    held = "an end of the body" if findings.held.definition else "by its name"
    yield f"Held: {findings.held.group}, {held}."
    for one in findings.actuated:
        kind = "Chamber" if one.group else "Cable"
        rim = ", sealed at its rim" if one.is_open else ""
        yield f"{kind}: {one.name}, {one.why}{rim}."
    if recorded is None:
        yield (
            "There are no readings yet: `softcal identify` and `softcal simulate` run; "
            "`softcal calibrate` needs readings (`--markers` of this command)."
        )
        return
    others = ", ".join(pose.name for pose in recorded.others) or "no other"
    yield f"Poses: {recorded.rest.name} (at rest) and {others}."
    yield (
        "Missing: where the markers are glued. Gravity acts in every reading, so the "
        "nearest points of the mesh are guessed, this far from those at rest:"
    )
    for marker in findings.markers:
        off = readable_values([marker.distance], "m", digits=3)
        yield f"  {marker.name}: {off if marker.distance else 'inside'}"
    if findings.own_frame:
        yield (
            "That is too far: the recording has its own frame. Follow the remarks at "
            "[markers] and [shared.measured]; then `softcal calibrate` runs."
        )


def add_new(commands: "argparse._SubParsersAction") -> None:
    command = commands.add_parser(
        "new",
        help="a commented project that runs, for your robot or a ready-made one",
        description="""\
Writes a new folder with a commented project file and all that it needs.

With --robot, that is a ready-made robot: beam, pneumatic-arm, tentacle, emio
(measured), cable-beam, pneumatic-finger, parallel-robot, pressed-pad or bellows-finger
(synthetic readings).

With --model, the project is for your own mesh or CAD model. Groups of the file are
listed in it. Where no file gives the unit, supports, loads or moduli, they are guessed;
each guess has a remark that says what to change or confirm.""",
        epilog=_NEW,
    )
    cli.add_path(command, "folder", "DIR", "the new folder, which must not exist yet")
    source = command.add_mutually_exclusive_group(required=True)
    source.add_argument("--robot", metavar="NAME", help="name of a ready-made robot")
    text = "a mesh (.msh, .vtu, .inp, ...) or CAD model (.step, .stl)"
    cli.add_path(source, "--model", "FILE", text)
    text = "a table of markers, or recordings over time (.c3d, ...), a pose in each"
    cli.add_path(command, "--markers", "FILE", text, nargs="+", default=[])
    text = 'edges of the tets of a CAD model, like "3 mm" (default: a twentieth of it)'
    command.add_argument("--size", metavar="LENGTH", help=text)
    text = "unit of the model: m, cm, mm, um or inch (default: guessed by its size)"
    command.add_argument("--length-unit", metavar="UNIT", help=text)
    cli.add_output(command)
    command.set_defaults(run=new)


_ABOUT_TAGS = """\
Draws tags, and a board on the last page, to scale. Glue one tag on a rigid part of the
robot and one on its base, photograph each pose with both in the picture from several
sides, and name the photographs in the project file:

  measured.effectors.sensor = { photos = "pose1/*.jpg", tag = 3, base_tag = 0,
                                size = "20 mm", board = "board/*.jpg" }

Photographs of the board calibrate the camera; without them the tags do.
"""

_TAGS = """\
examples:
  softcal tags -o tags.pdf
  softcal tags -o tags.pdf --size "35 mm" --count 4 --paper letter
"""


def tags(args: argparse.Namespace, show: Display) -> None:
    from softcal_jax._units import readable_values
    from softcal_jax.exchange.camera import write_tags

    cli.check_new(args.output, force=args.force)
    with cli.bad_input():
        size = quantity("--size", args.size, "m")
        options = {"count": args.count, "first": args.first, "paper": args.paper}
        n = write_tags(args.output, size=size, **options)
    numbers = [*range(args.first, args.first + args.count)]
    show.document({"file": str(args.output), "tags": numbers, "pages": n})
    side = readable_values([size], "m")
    show.line(
        f"Wrote tags {numbers[0]} to {numbers[-1]} of {side} and the board "
        f"to {args.output}: {n} pages. Print them at 100 %."
    )


def add_tags(commands: "argparse._SubParsersAction") -> None:
    parser = commands.add_parser(
        "tags",
        help="print tags, which photographs then measure as a 6-D sensor does",
        description=_ABOUT_TAGS,
        epilog=_TAGS,
    )
    cli.add_path(parser, "--output", "FILE.pdf", "the file", required=True)
    text = 'side of the black square of a tag (default: "20 mm")'
    parser.add_argument("--size", default="20 mm", metavar="LENGTH", help=text)
    text = "how many tags (default: 12)"
    parser.add_argument("--count", type=int, default=12, metavar="N", help=text)
    text = "number of the first tag (default: 0)"
    parser.add_argument("--first", type=int, default=0, metavar="N", help=text)
    text = "size of the sheets (default: a4)"
    parser.add_argument("--paper", default="a4", choices=["a4", "letter"], help=text)
    cli.add_output(parser, force="replace a file that is there")
    parser.set_defaults(run=tags)
