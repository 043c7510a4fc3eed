"""Text of users and of files on its way to a terminal, a spreadsheet or a disk.

A control character in a name can rewrite what a terminal shows, or worse, and a
spreadsheet runs a cell that begins like a formula.
"""

import re
import unicodedata
from collections.abc import Sequence

_HIDDEN = {"Cc", "Cs", "Zl", "Zp"}  # controls, lone surrogates, line separators
_TURNING = {"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"}
"""Classes of characters that change the direction of the text after them."""

_QUOTED = 200  # most characters of a text that messages quote
_NAMED = 60  # characters that are left of a name that is too long

# Neither the apostrophe of "robot's" nor the end of a quotation begins one. What is
# `shortened` already stays.
_LONG_QUOTED = re.compile(rf"(?<!\w)(['\"])((?:(?!\1).){{{_QUOTED + 4},}})\1(?!\w)")
_PART = r"[^\s/\\'\":,]"
_LONG_WORD = re.compile(rf"({_PART}{{{_NAMED}}}){_PART}{{{_QUOTED},}}")

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")


def _is_hidden(character: str) -> bool:
    hidden = unicodedata.category(character) in _HIDDEN and character not in "\n\t"
    return hidden or unicodedata.bidirectional(character) in _TURNING


def escaped(text: str) -> str:
    """Write control characters as escapes; tabs and ends of lines stay."""
    if text.isprintable():
        return text
    return "".join(
        c.encode("unicode_escape").decode() if _is_hidden(c) else c for c in text
    )


def shortened(text: str) -> str:
    """Cut a text that is too long to quote in a message."""
    return text if len(text) <= _QUOTED else f"{text[:_QUOTED]}..."


def with_short_names(text: str) -> str:
    """Shorten the names in a message that nobody reads to the end.

    They stand in quotes, or are words; where one is a path, its folders are words.
    """
    cut = lambda match: f"{match[1]}{match[2][:_NAMED]}...{match[1]}"
    return _LONG_WORD.sub(r"\1...", _LONG_QUOTED.sub(cut, text))


def check_characters(text: str) -> None:
    """Raise ValueError for a text with control characters."""
    if text.replace("\t", "").isprintable():  # quick, for long tables with tabs
        return
    for character in text:
        if _is_hidden(character):
            raise ValueError(
                f"got {shortened(text)!r}, with the control character {character!r}, "
                "which would act on a terminal; leave it out."
            )


def as_cell(text: str) -> str:
    """Write a text so that no spreadsheet takes it for a formula; numbers stay.

    Spreadsheets take a cell with an apostrophe before it for text (CWE-1236).
    """
    if text.startswith(_FORMULA) and not _NUMBER.fullmatch(text):
        return f"'{text}"
    return text


def from_cell(text: str) -> str:
    """Undo `as_cell`."""
    return text[1:] if text.startswith("'") and text[1:].startswith(_FORMULA) else text


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Write rows of texts as lines, indented, columns aligned on the left.

    A column without a text takes no room.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = zip(row, widths, strict=True)
        line = "  ".join(cell.ljust(width) for cell, width in cells if width)
        lines.append(f"  {line.rstrip()}")
    return lines
