"""Places on the disk: whether a file can be written there, by this program alone."""

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
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


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give the path of a new file, which takes the place of an older one as a whole."""
    partial = path.with_name(f"{path.stem}.partial{path.suffix}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        with suppress(OSError):
            partial.unlink()


def check_place(path: Path) -> None:
    """Raise OSError unless a file may stand at a path, in a folder that exists."""
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a directory; name a file in it.")
    if not path.parent.is_dir():
        raise FileNotFoundError(
            f"the folder {path.parent} of {path.name} does not exist: make it, or "
            "give a file in another one."
        )


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
        check_place(path)
        lock = path.with_name(path.name + ".lockfile")  # no other name is longer
        busy = f"another {program} is writing to {path}"
        held = locked(lock, f"{busy}: wait until it has ended, or give another file.")
    with held:
        yield


def locked(lock: Path, busy: str) -> ExitStack:
    """Lock a file, made for this, until the stack is closed; or say that it is busy."""
    with ExitStack() as opened:
        file = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        opened.callback(os.close, file)
        if not _locked(file, lock):
            raise BlockingIOError(busy)
        opened.callback(_remove, lock)
        os.write(file, bytes(512))  # a full disk has room for an empty file alone
        return opened.pop_all()


def _locked(file: int, lock: Path) -> bool:
    """Lock an open file, unless another program has; the lock ends with the process."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # Who had locked it may have removed it since it was opened.
        return os.path.samestat(os.fstat(file), lock.stat())
    except (BlockingIOError, FileNotFoundError, PermissionError):
        return False


def _remove(lock: Path) -> None:
    with suppress(PermissionError):  # Windows removes no open file
        lock.unlink(missing_ok=True)
