"""Places on the disk: whether a file can be written there, by this program alone."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


def cause(error: OSError) -> str:
    """Say in words why a file could not be used, without number and path."""
    return error.strerror or str(error)


@contextmanager
def with_remedy(refused: str, remedy: str) -> Iterator[None]:
    """Turn errors of the system, which have a number, into errors with a remedy."""
    try:
        yield
    except OSError as error:
        if error.errno is None:  # raised with a text of its own
            raise
        raise OSError(f"{refused} ({cause(error)}): {remedy}.") from error


def partial_of(path: Path) -> Path:
    """Return where a file is written before it takes the place of an older one."""
    return path.with_name(path.name + ".partial")


@contextmanager
def only_writer(path: Path, program: str) -> Iterator[None]:
    """Keep other programs from writing a file, once it is known that it can be written.

    A process that ends, even if it is killed, gives the file free. `program` is what
    messages call who writes it, like "sweep".

    Raises:
        BlockingIOError: If another one of these programs is writing the file.
        OSError: If the place cannot be written; the text says why.
    """
    with with_remedy(f"{path} cannot be written", "give another file"):
        if path.is_dir():
            raise IsADirectoryError(f"{path} is a folder; name a file in it.")
        if not path.parent.is_dir():
            raise FileNotFoundError(
                f"the folder {path.parent} of {path.name} does not exist: make it, or "
                "give a file in another one."
            )
        _try(path)
        file = _locked(path)
    if file is None:
        raise BlockingIOError(
            f"another {program} is writing to {path}: wait until it has ended, or give "
            "another file."
        )
    try:
        yield
    finally:
        with suppress(PermissionError):  # Windows removes no open file
            _lock_of(path).unlink(missing_ok=True)
        os.close(file)


def _lock_of(path: Path) -> Path:
    return path.with_name(path.name + ".lock")


def _locked(path: Path) -> int | None:
    """Open and lock a file beside the path; None if another program has locked it."""
    while True:
        file = os.open(_lock_of(path), os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if not _lock(file):
                os.close(file)
                return None
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file), _lock_of(path).stat()):
                    return file
        except OSError:
            os.close(file)
            raise
        os.close(file)  # what was opened has been removed by who had locked it


def _lock(file: int) -> bool:
    """Lock an open file, unless another program has; the lock ends with the process."""
    if sys.platform == "win32":
        import msvcrt

        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return False
    else:
        import fcntl

        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


def _try(path: Path) -> None:
    """Write a file beside the path, with a longer name than all that are needed."""
    trial = path.with_name(f"{path.name}.trial-{os.getpid():08d}")
    try:
        trial.write_bytes(bytes(512))
    finally:
        trial.unlink(missing_ok=True)
