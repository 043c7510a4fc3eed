"""The files that a calibration was made from, as they were when they were read."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from softcal_jax._files import sha256_of
from softcal_jax._module import Module


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
