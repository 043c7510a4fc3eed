"""Printing of text that others wrote: names, paths, the rows of a database."""

import argparse
import io
import sys
from collections.abc import Iterable
from typing import NoReturn

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from softcal_jax._text import escaped


class PlainConsole(Console):
    """A console that shows control characters in a text, where others obey them."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Render as `Console` does; its own control codes are segments of their own."""
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                yield Segment(escaped(segment.text), segment.style)


class PlainParser(argparse.ArgumentParser):
    """A parser that quotes wrong arguments without their control characters."""

    def error(self, message: str) -> NoReturn:
        """End the program with a message."""
        super().error(escaped(message))


def escape_what_cannot_be_encoded() -> None:
    """Let standard output and error show characters that their encoding lacks.

    That of the locale C, or of a pipe on Windows, may have no "±" or "ö": a command
    would end in a traceback once its work is done.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
