"""Writing what was found, so that an interruption or a full disk does not lose it."""

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from softcal_jax._places import cause
from softcal_jax.cli._display import Display
from softcal_jax.cli._shared import BAD_INPUT, INTERRUPTED, Stop, bad_input

Write = Callable[[Path, bool], Path]
"""Writes results to a folder, over earlier ones if the flag is set."""


def write_results(
    write: Write, args: argparse.Namespace, show: Display, *, index: str, force: bool
) -> None:
    """Write what is printed already, and say where it is, or print its `index`.

    Where its folder cannot be written any more, as on a full disk, it goes to a
    temporary one, and the command ends with a message.
    """
    show.now("writing results")
    with bad_input():
        try:
            where = write(args.output, force)
        except OSError as error:
            more = f"{_elsewhere(write)} {checkpoint_stands(args)}".strip()
            raise Stop(BAD_INPUT, f"error: {error}\n{more}") from error
    show.lap("results and pictures")
    if show.as_json:
        show.document(json.loads((where / index).read_text(encoding="utf-8")))
    show.results(where)


def pictures_with_a_bar(args: argparse.Namespace, show: Display) -> dict[str, Any]:
    """Return what results are written with: which pictures, and how they are told."""
    told = lambda done, total: show.now(
        "drawing pictures", log=False, count=(done, total)
    )
    return {"pictures": None if args.no_pictures else args.pictures, "told": told}


def _elsewhere(write: Write) -> str:
    """Write results to a temporary folder, and say what became of them."""
    second = None
    try:
        second = Path(tempfile.mkdtemp(prefix="softcal_"))
        write(second, False)
    except OSError as error:
        if second is not None:
            with suppress(OSError):
                second.rmdir()
        return (
            f"Nor could they be written to {tempfile.gettempdir()} ({cause(error)}): "
            "what was found is printed above."
        )
    return f"The results are in {second} instead: copy them before it is emptied."


@contextmanager
def interruptible(args: argparse.Namespace) -> Iterator[None]:
    """End an interrupted calibration with how to go on from its checkpoint."""
    try:
        yield
    except KeyboardInterrupt:
        stands = checkpoint_stands(args)
        if not stands:
            raise
        raise Stop(INTERRUPTED, f"interrupted. {stands}") from None


def checkpoint_stands(args: argparse.Namespace) -> str:
    """Say how to go on from the checkpoint; empty if there is none."""
    path = getattr(args, "checkpoint", None)
    if path is None or not path.is_file():
        return ""
    return (
        f"The checkpoint {path} stands: the same command goes on from it, with --force "
        "if the folder of the results is no longer empty."
    )
