"""Checks of files before they are opened, whether they are still the same, CSV rows."""

import csv
import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, wraps
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax._module import Module
from softcal_jax._places import MEGABYTES
from softcal_jax._text import as_cell, suggestion

_LOOKED_AT = 1000  # most files of a folder that are compared with a misspelt name


def check_file(path: Path, what: str) -> None:
    """Raise unless a path is that of a regular file of a size that may be read.

    A pipe would wait for ever, and a device like /dev/zero never ends. `what` is what
    messages call it, like "mesh file".
    """
    if not path.exists():
        raise FileNotFoundError(f"{what} {path} does not exist.{similar_file(path)}")
    if path.is_dir():
        raise ValueError(f"{what} {path} is a directory; name the file in it.")
    if not path.is_file():
        raise ValueError(
            f"{what} {path} is a pipe or a device; expected a file on a disk."
        )
    MEGABYTES.check(f"{what} {path}", path.stat().st_size / 1e6)


def sha256_of(path: Path) -> str:
    """Compute the SHA-256 of a file, as `sha256sum` writes it."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def once(read: Callable[..., Any], *, most: int = 8) -> Callable[..., Any]:
    """Keep what the last files gave until they change: poses share long tables."""
    kept = lru_cache(maxsize=most)(lambda sha256, *given, **more: read(*given, **more))
    content = lambda path: sha256_of(path) if path.is_file() else None
    return wraps(read)(lambda path, *a, **more: kept(content(path), path, *a, **more))


def digest_of(arrays: Iterable[Any], text: str = "") -> str:
    """Digest a text, and arrays with their shapes and types."""
    digest = hashlib.sha256(text.encode())
    for array in map(np.asarray, arrays):
        digest.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


def similar_file(path: Path) -> str:
    """Suggest another file of the folder, or say that there is no such folder.

    The text is a sentence after a space, like that of `suggestion`.
    """
    if not path.parent.is_dir():
        return f" There is no folder {path.parent}."
    others = islice(path.parent.iterdir(), _LOOKED_AT)
    return suggestion(path.name, (other.name for other in others if other.is_file()))


def write_rows(path: Path, heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write rows as CSV, so that no spreadsheet takes a text for a formula."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        for row in (heads, *rows):
            writer.writerow([as_cell(c) if isinstance(c, str) else c for c in row])


class SourceFile(Module):
    """A file, and what it held.

    Attributes:
        path: Where it is; absolute.
        sha256: SHA-256 of its content.
    """

    path: Path
    sha256: str

    @classmethod
    def of(cls, path: Path) -> "SourceFile":
        """Digest a file as it is now; a link keeps its own name."""
        return cls(path.parent.resolve() / path.name, sha256_of(path))


class ProjectSource(Module):
    """A project file, and the files that it names.

    Attributes:
        project: The project file.
        files: Mesh and measurements that it names.
        changes: Values that replaced those of the file, by key, see `load_project`.
    """

    project: SourceFile
    files: tuple[SourceFile, ...]
    changes: Mapping[str, Any]

    @classmethod
    def of(
        cls, project: Path, files: Iterable[Path], changes: Mapping[str, Any] | None
    ) -> "ProjectSource":
        """Digest a project file and those that it names as they are now."""
        named = tuple(SourceFile.of(file) for file in files)
        return cls(SourceFile.of(project), named, dict(changes or {}))
