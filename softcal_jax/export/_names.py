"""File names from the names that a user gave."""

import re
from collections.abc import Sequence

_RESERVED = {"convergence", "markers", "result", "simulation"}
"""Stems of the other files of a results folder."""


def file_stems(names: Sequence[str]) -> list[str]:
    """Make one file name per configuration, without extension, safe on every system.

    Args:
        names: Names of the configurations.

    Returns:
        The names with anything but letters, digits, ".", "-" and "_" replaced, and with
        a number where two would be the same file on a system that ignores case.
    """
    taken = set(_RESERVED)
    stems = []
    for name in names:
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._")[:80]
        stem = stem or "configuration"
        unique, copy = stem, 2
        while unique.lower() in taken:
            unique, copy = f"{stem}_{copy}", copy + 1
        taken.add(unique.lower())
        stems.append(unique)
    return stems
