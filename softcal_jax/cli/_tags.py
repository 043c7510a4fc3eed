"""`softcal tags`: the tags that photographs are taken of, to print."""

import argparse
from collections.abc import Callable

from softcal_jax.cli._shared import (
    OK,
    Display,
    add_output,
    add_path,
    bad_input,
    check_new,
)
from softcal_jax.exchange.exporters import quantity

_ABOUT = """\
Draws tags, and a board on the last page, to scale. Glue one tag on a rigid part of the
robot and one on its base, photograph each pose with both in the picture from several
sides, and name the photographs in the project file:

  measured.effectors.sensor = { photos = "pose1/*.jpg", tag = 3, base_tag = 0,
                                size = "20 mm", board = "board/*.jpg" }

Photographs of the board calibrate the camera; without them the tags do.
"""

_EXAMPLES = """\
examples:
  softcal tags -o tags.pdf
  softcal tags -o tags.pdf --size "35 mm" --count 4 --paper letter

exit codes: 0 written, 2 bad input
"""


def tags(args: argparse.Namespace, show: Display) -> int:
    """Write a PDF with tags and a board."""
    from softcal_jax.exchange.camera import write_tags

    check_new(args.output, force=args.force)
    with bad_input():
        size = quantity("--size", args.size, "m")
        options = {"count": args.count, "first": args.first, "paper": args.paper}
        n = write_tags(args.output, size=size, **options)
    last = args.first + args.count - 1
    about = {"tags": [*range(args.first, last + 1)], "pages": n}
    show.document({"file": str(args.output), **about})
    show.line(
        f"Wrote tags {args.first} to {last} of {1e3 * size:g} mm and the board to "
        f"{args.output}: {n} pages. Print them at 100 %."
    )
    return OK


def add_tags(commands: "argparse._SubParsersAction", raw: Callable) -> None:
    """Add the command to those of the parser."""
    parser = commands.add_parser(
        "tags",
        help="print tags, which photographs then measure as a 6-D sensor does",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=raw,
    )
    add_path(parser, "--output", "FILE.pdf", "the file", required=True)
    text = 'side of the black square of a tag (default: "20 mm")'
    parser.add_argument("--size", default="20 mm", metavar="LENGTH", help=text)
    text = "how many tags (default: 12)"
    parser.add_argument("--count", type=int, default=12, metavar="N", help=text)
    text = "number of the first tag (default: 0)"
    parser.add_argument("--first", type=int, default=0, metavar="N", help=text)
    text = "size of the sheets (default: a4)"
    parser.add_argument("--paper", default="a4", choices=["a4", "letter"], help=text)
    text = "replace a file that is there"
    parser.add_argument("--force", action="store_true", help=text)
    add_output(parser)
    parser.set_defaults(run=tags)
