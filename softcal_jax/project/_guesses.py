"""Values of a project file that `softcal new` guessed, and nobody has confirmed yet."""

import os
import re
from pathlib import Path
from typing import NamedTuple

from softcal_jax._module import one_line

CHANGE = "# CHANGE: "
"""How the remark begins at the end of a line, or before one, that holds a guess."""

_GUESS = re.compile(rf"(?P<text>.*?)\s*{CHANGE}(?P<remark>.+)")


class Guess(NamedTuple):
    """A line of a project file, from 1, and the remark on what is to be confirmed."""

    line: int
    text: str
    remark: str

    __repr__ = one_line


def guesses_left(path: str | os.PathLike[str]) -> tuple[Guess, ...]:
    """List the lines of a project file that still have the remark of a guess."""
    lines = Path(path).read_text(encoding="utf-8").splitlines()
    found = ((n, _GUESS.match(line)) for n, line in enumerate(lines, start=1))
    return tuple(
        Guess(n, match["text"].strip(), match["remark"].strip())
        for n, match in found
        if match
    )
