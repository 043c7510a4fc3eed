"""Text that users type or read: names, messages, and what a terminal may show.

A control character in a name can rewrite what a terminal shows, or worse, and a
spreadsheet runs a cell that begins like a formula.
"""

import difflib
import hashlib
import re
import unicodedata
from collections.abc import Collection, Iterable, Sequence

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


UNNAMED_LOADS = "loads"  # name of the dead loads that have none of their own


def suggestion(name: str, known: Iterable[str], *, quote: str = "'") -> str:
    """Suggest the closest known name, in a sentence after a space; empty if none."""
    by_lower = {k.lower(): k for k in known}
    near = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=0.5)
    return f" Did you mean {quote}{by_lower[near[0]]}{quote}?" if near else ""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> ValueError:
    """Build the error for an unknown name, with the closest known one suggested."""
    # Numbers by their size: face 2 before face 10.
    digits = lambda match: f"{len(match[0]):6}{match[0]}"
    names = sorted(known, key=lambda text: re.sub("[0-9]+", digits, text))
    listed = ", ".join(map(repr, names)) or "none"
    hint = suggestion(name, names)
    return ValueError(f"unknown {kind} {name!r}.{hint} Known: {listed}.")


def check_known(kind: str, known: Collection[str], *names: str) -> None:
    """Raise ValueError if a name is unknown, with the closest known one suggested."""
    for name in names:
        if name not in known:
            raise unknown_name(kind, str(name), known)


def check_unique(kind: str, names: Sequence[str]) -> None:
    """Raise ValueError if a name occurs twice."""
    for name in names:
        if names.count(name) > 1:
            raise ValueError(
                f"{kind} {name!r} is named more than once; give each another name."
            )


def parse_axes(axes: str) -> list[int]:
    """Return the indices of the axes in a word like "xz"."""
    if not axes or set(axes) - set("xyz") or len(set(axes)) != len(axes):
        raise ValueError(
            f'axes must be some of "xyz", each once, like "xz"; got {axes!r}.'
        )
    return ["xyz".index(letter) for letter in axes]


MOST_NAMED = 6  # most poses or parameters that share a sentence


def listed(names: Sequence[str], most: int | None = None) -> str:
    """Join names like "a, b and c", or beyond `most` "a, b and 7 more"; else "none"."""
    if most is not None and len(names) > most:
        names = [*names[:most], f"{len(names) - most} more"]
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]])) or "none"


def name_key(name: str) -> int:
    """Turn a name into an integer of 63 bits, since arrays hold no text.

    One compiled program then serves configurations of any names, and a parameter of
    some configurations recognises them in every batch. That two of a million names
    have one key has a chance of 1e-7.
    """
    digest = hashlib.blake2b(name.encode(), digest_size=8).digest()
    return int.from_bytes(digest) >> 1


class SoftcalWarning(UserWarning):
    """Any warning of this package: the commands show each as a line of its own."""
