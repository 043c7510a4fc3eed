"""Names that a user types, and messages for misspelt ones."""

import difflib
import hashlib
import re
from collections.abc import Collection, Iterable, Sequence

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
