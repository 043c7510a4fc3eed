"""The files that a calibration was made from as a dictionary for JSON."""

import os
from pathlib import Path
from typing import Any

from softcal_jax.calibration import ProjectSource, SourceFile
from softcal_jax.export._plain import plain


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
