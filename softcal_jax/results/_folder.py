"""A results folder that appears whole or not at all."""

import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from softcal_jax._files import sha256_of
from softcal_jax._places import locked, with_remedy
from softcal_jax._text import listed

STAMP = ".softcal-files"
"""File of a results folder that lists the others as they were written."""

_FORMAT = "softcal_jax.files/1"
_REPLACED = ".replaced"  # earlier results, while others take their place

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
        FileExistsError: If it is a file; or if it is not empty, and `force` is off, it
            is not a results folder, or one of its files has changed. Nothing but
            earlier results is ever replaced.
        OSError: If nothing can be written there, as while another process does; the
            text says why.
    """
    with _partial_folder(Path(directory), force=force) as (_, directory):
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
    written = _written(directory)
    if not written:
        raise FileExistsError(
            f"the folder {directory} does not hold earlier results of softcal_jax: no "
            f"{STAMP} in it lists them. So nothing in it is replaced. Choose another "
            "folder, or empty it yourself."
        )
    changed = [name for name, same in written.items() if not same]
    if changed:
        raise FileExistsError(
            f"the folder {directory} holds files that changed since softcal_jax wrote "
            f"them ({listed(changed)}), so nothing in it is replaced. Move or rename "
            "these, or choose another folder."
        )


@contextmanager
def results_folder(
    directory: str | Path, *, force: bool = False, replaceable: bool = True
) -> Iterator[Path]:
    """Make a temporary folder which becomes `directory` at the end, whole.

    A new folder appears by a single renaming; into one that is there files are moved
    one by one, so that those of a user stay. If the block raises, earlier results stay
    as they were. What a killed process has left is completed, or removed if it was not
    whole, by the next call. Missing parents are created. With `force` earlier results
    are replaced, if they were written as `replaceable`: ".softcal-files" lists these,
    with size and SHA-256.

    Raises:
        FileExistsError: As `check_results_folder`, or if a foreign file would be
            overwritten.
        OSError: If the files cannot be written; the text says why.
    """
    with _partial_folder(Path(directory), force=force) as (partial, directory):
        yield partial
        if replaceable:
            files = {path.name: _stamp(path) for path in sorted(partial.iterdir())}
            text = json.dumps({"format": _FORMAT, "files": files}, indent=2)
            (partial / STAMP).write_text(f"{text}\n", encoding="utf-8")
        _move_into_place(partial, directory)


def complete_results(directory: Path) -> None:
    """Move results into place that a killed process has left complete beside it."""
    with suppress(OSError):  # such as a disk that cannot be written
        if _lock(directory.resolve()).exists():
            check_results_folder(directory, force=True)


def _lock(directory: Path) -> Path:
    """Return the file, beside a folder, that a process locks to write the folder."""
    # Not named after the folder, whose name may be as long as a name can be.
    mark = hashlib.sha256(os.fsencode(directory.name)).hexdigest()[:16]
    return directory.parent / f".softcal.{mark}.lock"


@contextmanager
def _partial_folder(directory: Path, *, force: bool) -> Iterator[tuple[Path, Path]]:
    """Make a folder beside another one, and missing parents; yield both, as absolute.

    One process at a time has it. At the end, empty new parents are removed, too.
    """
    refused = f"no results can be written to {directory}"
    directory = directory.resolve()
    with with_remedy(refused, _REMEDY), ExitStack() as made:
        for parent in reversed(directory.parents):
            if not parent.exists():
                parent.mkdir()
                made.callback(_remove_empty, parent)
        lock, busy = _lock(directory), f"another process writes to {directory}"
        made.enter_context(locked(lock, f"{busy}: wait for its end, or {_REMEDY}."))
        partial = lock.with_suffix(".partial")
        if _written(partial):
            _move_into_place(partial, directory)
        _discard(partial)
        _check_contents(directory, force=force)
        partial.mkdir()
        made.callback(_discard, partial)
        yield partial, directory


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


def _discard(partial: Path) -> None:
    # First the stamp, without which a part of the files does not count as results.
    (partial / STAMP).unlink(missing_ok=True)
    shutil.rmtree(partial, ignore_errors=True)


def _stamp(file: Path) -> dict[str, int | str]:
    return {"size": file.stat().st_size, "sha256": sha256_of(file)}


def _written(folder: Path) -> dict[str, bool]:
    """Tell which files of a folder softcal_jax wrote, and if they are still the same.

    The list of them is one; names that lead out of the folder are ignored.
    """
    files = {}
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        data = json.loads((folder / STAMP).read_text(encoding="utf-8"))
        if data["format"] == _FORMAT:
            files = {STAMP: None, **data["files"]}
    return {
        name: name == STAMP or _stamp(folder / name) == stamp
        for name, stamp in files.items()
        if Path(name).name == name and (folder / name).is_file()
    }


def _move_into_place(partial: Path, directory: Path) -> None:
    if not directory.exists():
        os.rename(partial, directory)
        return
    # Where this is cut short, an index has its files: new ones come before it, earlier
    # ones go after it. The list of files, by which the rest is done later, is the last.
    new = {path.name for path in partial.iterdir()} - {_REPLACED}
    old = {name for name, same in _written(directory).items() if same}
    order = lambda n: (n == STAMP, n not in new, n.endswith(".json"), n)
    foreign = [n for n in sorted(new - old) if (directory / n).exists()]
    if foreign:
        raise FileExistsError(
            f"{directory / foreign[0]} is not part of the earlier results and would be "
            "overwritten. Move it away, or choose another folder."
        )
    backup = partial / _REPLACED
    backup.mkdir(exist_ok=True)
    with ExitStack() as undo:
        for name in sorted(new | old, key=order):
            place, keep = directory / name, shutil.copy2 if name in new else os.replace
            if name in old:
                keep(place, backup / name)
                undo.callback(os.replace, backup / name, place)
            else:
                undo.callback(place.unlink, missing_ok=True)
            if name in new:
                os.replace(partial / name, place)
        undo.pop_all()
