"""Compile in less time, and keep compiled programs on disk for the next process.

JAX manages the cache. The key of a program includes its text, the versions of JAX and
XLA and the instruction set of the processor, so one folder serves several machines.
"""

import glob
import os
import re
import stat
import tempfile
import warnings
from contextlib import suppress
from pathlib import Path

import jax
import platformdirs

from softcal_jax._text import SoftcalWarning

LARGEST = 2_000_000_000  # size above which the least recently used programs go [bytes]
HAS_OLDER_CODE = jax.__version_info__ < (0, 11, 1)
"""Whether XLA still has the older code for fused loops on a CPU, and the flag for it.

Later versions end the process at a flag that they do not know.
"""

_EMITTERS = "--xla_cpu_use_fusion_emitters"
_QUICKLY = f"{_EMITTERS}=0"  # a user's own "=false" stays

_MAX_SIZE = "jax_compilation_cache_max_size"  # -1 for no limit


class CompilationCacheWarning(SoftcalWarning):
    """Compiled programs are not kept."""


def use_compilation_cache(
    folder: Path | None = None, *, quickly: bool = True
) -> Path | None:
    """Compile quickly, keep what this process compiles, reuse what was kept before.

    It acts on the whole process, so programs call it, before anything is compiled, and
    libraries do not. Programs are native code that later runs execute, so the folder
    must be out of the reach of others: a new one gets the mode 0700, and one that
    belongs to others or that they may write is refused.

    Programs that were used longest ago are removed until those left take at most
    `LARGEST`, or JAX_COMPILATION_CACHE_MAX_SIZE [bytes, -1 for no limit]. JAX itself
    would go through all entries whenever it writes one, and needs the package filelock.

    Args:
        folder: Cache folder; by default JAX_COMPILATION_CACHE_DIR, else a folder in the
            user's cache.
        quickly: Whether XLA compiles fused loops on a CPU by older code, if it has it
            (up to JAX 0.11.0) and XLA_FLAGS does not say otherwise. That takes less
            time, but programs run slower, so workers of sweeps do not. A batch of
            `vmap` may then differ from its members in the last bit.

    Returns:
        The absolute path of the folder. None if JAX_ENABLE_COMPILATION_CACHE=0 switched
        the cache off, if JAX_COMPILATION_CACHE_DIR is an address like "gs://...", or,
        with one `CompilationCacheWarning`, if the folder is refused.
    """
    flags = os.environ.get("XLA_FLAGS", "").replace(_QUICKLY, "").strip()
    quickly = quickly and HAS_OLDER_CODE and _EMITTERS not in flags
    if quickly and flags[:1] in ("", "-"):  # no file
        flags = f"{flags} {_QUICKLY}".strip()
    os.environ["XLA_FLAGS"] = flags
    if not jax.config.values["jax_enable_compilation_cache"]:
        return None
    chosen = str(folder or jax.config.values["jax_compilation_cache_dir"] or "")
    if "://" in chosen:
        return None  # JAX handles addresses itself
    try:
        folder = _usable(chosen)
    except ValueError as error:
        # Otherwise JAX would try, and warn, for every single program.
        jax.config.update("jax_enable_compilation_cache", False)
        warnings.warn(
            "compiled programs are not kept, so that every run compiles them anew: "
            f"{error}. Name another folder in JAX_COMPILATION_CACHE_DIR, or set "
            "JAX_ENABLE_COMPILATION_CACHE=0.",
            CompilationCacheWarning,
            stacklevel=2,
        )
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
    _remove_least_recently_used(folder)
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        # By default JAX keeps only programs that take a second to compile. A run has
        # two hundred faster ones, which together take as long as the large ones.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    return folder


def throw_away_damaged(message: str) -> str | None:
    """Remove the entry that JAX has just failed to read, so that it writes a new one.

    A process killed while writing can leave half an entry. JAX then warns and compiles
    the program, but keeps the entry, so it would fail in every run. Returns what to
    tell the user; None if the message is about something else.
    """
    pattern = r"Error reading persistent compilation cache entry for '(.+?)':"
    match = re.match(pattern, message)
    folder = jax.config.values["jax_compilation_cache_dir"]
    if match is None or folder is None:
        return None
    program = match[1]
    for entry in Path(folder).glob(f"{glob.escape(program)}-*-cache"):
        entry.unlink(missing_ok=True)
    return (
        f"the compiled program {program} on the disk was damaged; it is compiled again."
    )


def _usable(chosen: str) -> Path:
    """Create the folder that was chosen, or the usual one; or raise why not."""
    try:
        usual = lambda: platformdirs.user_cache_path("softcal_jax", appauthor=False)
        folder = (Path(chosen) if chosen else usual() / "jax").expanduser().absolute()
    except RuntimeError:
        # Older versions of platformdirs return "~/...", which Path cannot expand.
        text = "the user's cache has no place, because there is no home folder"
        raise ValueError(text) from None
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        # Before anything is written there.
        problem = _reach_of_others(folder.resolve()) if os.name == "posix" else None
        if problem is None:
            tempfile.TemporaryFile(dir=folder).close()
            return folder
    except OSError as error:
        problem = f"cannot be written ({error.strerror or error})"
    raise ValueError(f"{folder} {problem}")


def _reach_of_others(folder: Path) -> str | None:
    """Say how others could put programs into a folder; None if they cannot."""
    status = folder.stat()
    if status.st_uid != os.getuid():
        return (
            f"belongs to another user (uid {status.st_uid}), whose programs would run "
            "under your name"
        )
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return (
            f"may be written by others (mode {stat.S_IMODE(status.st_mode):04o}); if "
            f"all in it are your own, `chmod 700 {folder}` makes it private"
        )
    for parent in folder.parents:
        mode = parent.stat().st_mode
        # In a folder like /tmp only the owner may replace what is his.
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            return f"may be replaced by anyone, who may write {parent}"
    return None


def _remove_least_recently_used(folder: Path) -> None:
    """Remove programs that were used longest ago from a folder that is too large."""
    limit = jax.config.values[_MAX_SIZE]
    if limit == -1:
        limit = int(os.environ.get(_MAX_SIZE.upper(), LARGEST))
    jax.config.update(_MAX_SIZE, -1)
    if limit == -1:
        return
    kept = []
    for entry in folder.glob("*-cache"):
        with suppress(FileNotFoundError):  # another process may remove them as well
            status = entry.stat()
            kept.append((max(status.st_atime, status.st_mtime), status.st_size, entry))
    too_much = sum(size for _, size, _ in kept) - limit
    for _, size, entry in sorted(kept):
        if too_much <= 0:
            return
        with suppress(PermissionError):  # of a file that is being read, on Windows
            entry.unlink(missing_ok=True)
            too_much -= size
