"""A results folder that appears whole or not at all."""

import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from softcal_jax._places import with_remedy

INDEX_FILES = (
    "result.json",
    "simulation.json",
    "identifiability.json",
    "comparison.json",
    "inverse.json",
    "robot.json",
    "design.json",
    "icesl.json",
)
"""Files that mark a results folder; their `files` list what softcal_jax wrote."""

_REMEDY = "choose another folder"

_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)
"""Names that are devices on Windows, whatever follows a point."""


def file_stems(names: Sequence[str]) -> list[str]:
    """Make one file name per configuration, without extension, safe on every system.

    Anything but letters, digits, ".", "-" and "_" is replaced. A number is added where
    a name is taken, alone or with "_robot" (actuators) or "_recording" (markers over
    time) at its end. Upper and lower case count as equal, as on some systems.
    """
    taken = {"inverse", "markers", "report", "result", "simulation"}  # other files
    endings = ("", "_robot", "_recording")
    stems = []
    for name in names:
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._")[:80]
        if not stem or _DEVICE.match(stem):
            stem = f"configuration_{stem}".strip("_")
        unique, copy = stem, 2
        while taken & (files := {unique.lower() + end for end in endings}):
            unique, copy = f"{stem}_{copy}", copy + 1
        taken |= files
        stems.append(unique)
    return stems


def check_results_folder(directory: str | Path, *, force: bool = False) -> None:
    """Raise unless results can be written to a folder; call it before a long run.

    Raises:
        FileExistsError: If it is a file; or if it is not empty, and `force` is off or
            it is not a results folder. Nothing but earlier results is ever replaced.
        OSError: If nothing can be written there; the text says why.
    """
    directory = Path(directory)
    with with_remedy(f"no results can be written to {directory}", _REMEDY):
        _check_contents(directory, force=force)
        with _partial_folder(directory.resolve()):
            if directory.exists():
                tempfile.TemporaryFile(dir=directory).close()
            else:
                directory.mkdir()
                directory.rmdir()


def _check_contents(directory: Path, *, force: bool) -> None:
    """Raise if a folder holds anything but earlier results that may be replaced."""
    if directory.exists() and not directory.is_dir():
        raise FileExistsError(f"{directory} is a file; results need a folder.")
    if not (directory.exists() and any(directory.iterdir())):
        return
    if not force:
        raise FileExistsError(
            f"the folder {directory} is not empty. Choose another one, or replace the "
            "results in it with --force (force=True)."
        )
    if not _earlier_files(directory):
        raise FileExistsError(
            f"the folder {directory} does not hold earlier results of softcal_jax "
            f"({', '.join(INDEX_FILES)}), so nothing in it is replaced. Choose "
            "another folder, or empty it yourself."
        )


@contextmanager
def results_folder(directory: str | Path, *, force: bool = False) -> Iterator[Path]:
    """Make a temporary folder whose files move into `directory` at the end.

    If the block raises, the temporary folder is removed and earlier results stay as
    they were. With `force` earlier results are replaced, but not files of the user.
    Missing parents are created.

    Raises:
        FileExistsError: As `check_results_folder`, or if a foreign file would be
            overwritten.
        OSError: If the files cannot be written; the text says why.
    """
    directory = Path(directory).resolve()
    with with_remedy(f"no results can be written to {directory}", _REMEDY):
        _check_contents(directory, force=force)
        with _partial_folder(directory) as partial:
            yield partial
            _move_into_place(partial, directory)


@contextmanager
def _partial_folder(directory: Path) -> Iterator[Path]:
    """Make a temporary folder beside a path, and the missing parents of the path.

    At the end, new parents that are still empty are removed, too.
    """
    with ExitStack() as made:
        for parent in reversed(directory.parents):
            if not parent.exists():
                parent.mkdir()
                made.callback(_remove_empty, parent)
        # Not named after the folder, whose name may be as long as a name can be.
        partial = Path(tempfile.mkdtemp(prefix=".softcal.", dir=directory.parent))
        made.callback(shutil.rmtree, partial, ignore_errors=True)
        yield partial


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


def _earlier_files(directory: Path) -> set[str]:
    """List the files of earlier results, as their index files name them."""
    named: set[str] = set()
    for index in INDEX_FILES:
        with suppress(OSError, ValueError, KeyError, TypeError):  # no index of ours
            data = json.loads((directory / index).read_text(encoding="utf-8"))
            named |= {index, *data["files"]}
    # Ignore names that lead out of the folder, whatever the index says.
    return {n for n in named if Path(n).name == n and (directory / n).is_file()}


def _move_into_place(partial: Path, directory: Path) -> None:
    # Move single files, so that a shell whose working folder this is keeps it.
    new = sorted(path.name for path in partial.iterdir())
    old = _earlier_files(directory)
    foreign = [n for n in new if (directory / n).exists() and n not in old]
    if foreign:
        raise FileExistsError(
            f"{directory / foreign[0]} is not part of the earlier results and would be "
            "overwritten. Move it away, or choose another folder."
        )
    backup = partial / ".replaced"
    backup.mkdir()
    with ExitStack() as undo:
        if not directory.exists():
            directory.mkdir()
            undo.callback(directory.rmdir)
        for name in sorted(old):
            os.replace(directory / name, backup / name)
            undo.callback(os.replace, backup / name, directory / name)
        for name in new:
            os.replace(partial / name, directory / name)
            undo.callback((directory / name).unlink)
        undo.pop_all()
