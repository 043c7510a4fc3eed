"""What a result was computed from and with, as a dictionary for JSON."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from softcal_jax._module import Module
from softcal_jax.calibration import ProjectSource, SourceFile
from softcal_jax.equilibrium import Model
from softcal_jax.export._plain import plain, versions


class Made(Module):
    """What a result was computed from and with.

    Attributes:
        model: The model, whose solver names its package.
        settings: Settings by name; those of settings may nest.
        source: The project file, and what it names; None for a model made in Python.
    """

    model: Model
    settings: Mapping[str, Any]
    source: ProjectSource | None = None


def made_dict(made: Made | None, directory: str | Path = ".") -> dict[str, Any]:
    """Convert what a result was computed from and with to a dictionary.

    Keys: `source` (see `source_dict`), `settings`, `versions`.

    Args:
        made: What it was; None if that is not known.
        directory: Folder of the results.
    """
    if made is None:
        return {"source": None, "settings": {}, "versions": {}}
    return {
        "source": source_dict(made.source, directory),
        "settings": plain(made.settings),
        "versions": versions(made.model),
    }


def source_dict(
    source: ProjectSource | None, directory: str | Path = "."
) -> dict[str, Any] | None:
    """Convert the files that a calibration was made from to a dictionary.

    Keys: `project` (`file`, relative to the folder of the results, and `sha256`);
    `files`, mesh and measurements (likewise, relative to the folder of the project);
    `changes` of the project file, by key. None for a calibration without a project
    file.

    Args:
        source: The files.
        directory: Folder of the results.
    """
    if source is None:
        return None
    folder = source.project.path.parent
    return {
        "project": file_dict(source.project, directory),
        "files": [file_dict(file, folder) for file in source.files],
        "changes": plain(source.changes),
    }


def file_dict(file: SourceFile, directory: str | Path = ".") -> dict[str, str]:
    """Convert a file to a dictionary: `file`, relative to a folder, and `sha256`."""
    try:
        relative = os.path.relpath(file.path, Path(directory).resolve())
    except ValueError:  # on another drive of Windows
        return {"file": file.path.as_posix(), "sha256": file.sha256}
    return {"file": Path(relative).as_posix(), "sha256": file.sha256}
