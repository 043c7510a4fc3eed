"""Files: limits on what is read, checks before one is opened, and places to write.

A file cannot raise the limits, environment variables do: it may be somebody else's, or
hold the slip that they catch.
"""

import hashlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import lru_cache, wraps
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from softcal_jax._module import Module
from softcal_jax._text import suggestion


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
# Trials of a sweep in one database or part, and starts of a calibration.
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
