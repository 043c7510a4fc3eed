"""Limits on what is read, and places on the disk to write to.

A file cannot raise the limits, environment variables do: it may be somebody else's, or
hold the slip that they catch. Nothing here is slow to import.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple


class LimitError(ValueError):
    """There is more of something than is read or run; the text names the remedy."""


class Limit(NamedTuple):
    """The largest number of something, above which it is taken for a mistake.

    It is `usual`, unless the environment variable `variable` holds another number.
    """

    variable: str
    usual: int
    unit: str

    @property
    def most(self) -> float:
        """The limit that is in force."""
        text = os.environ.get(self.variable, "").strip()
        try:
            most = float(text or self.usual)
        except ValueError:
            most = 0.0
        if not most > 0.0:
            raise ValueError(
                f"the environment variable {self.variable} is {text!r}; expected a "
                f"number of {self.unit}, like {self.usual}."
            )
        return most

    def check(self, what: str, n: float) -> None:
        """Raise LimitError if `n` is above the limit; `what` opens the message."""
        if n > self.most:
            raise self.error(what, n)

    def error(self, what: str, n: float) -> LimitError:
        """Return the error that says that `n` is above the limit."""
        return LimitError(
            f"{what}: {_shown(n)} {self.unit}, more than the limit of "
            f"{_shown(self.most)}. If that is meant, raise the limit with the "
            f"environment variable {self.variable}."
        )


def _shown(n: float) -> str:
    return f"{min(n, 1e300):.3g}" if n >= 1e9 else f"{n:,.15g}".replace(",", " ")


# Tets of a mesh; a million quadratic ones take more than 10 GB to solve.
TETS = Limit("SOFTCAL_MAX_TETS", 2_000_000, "tets")
# Trials of a sweep or a part of one, and starts of a calibration.
TRIALS = Limit("SOFTCAL_MAX_TRIALS", 100_000, "trials")
# Trials of a sweep that runs in parts.
PLANNED = Limit("SOFTCAL_MAX_PLANNED", 10_000_000, "trials")
# Size of a file that is read, and of what is packed in it [MB].
MEGABYTES = Limit("SOFTCAL_MAX_FILE_MB", 100, "MB")
# Time and memory that filling a CAD model takes; a damaged one may take any.
MESHING_SECONDS = Limit("SOFTCAL_MAX_MESHING_S", 600, "s")
MESHING_MEGABYTES = Limit("SOFTCAL_MAX_MESHING_MB", 8000, "MB")


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
