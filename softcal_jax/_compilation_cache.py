"""Keep compiled programs on disk, so that the next process need not compile them.

JAX manages the cache. The key of a program includes its text, the versions of JAX and
XLA and the instruction set of the processor, so one folder serves several machines.
"""

import glob
import os
import re
import tempfile
import warnings
from pathlib import Path

import jax
import platformdirs


class CompilationCacheWarning(UserWarning):
    """Compiled programs are not kept."""


def use_compilation_cache(folder: Path | None = None) -> Path | None:
    """Keep the programs that this process compiles, and reuse those kept before.

    It acts on the whole process, so programs call it and libraries do not. Call it
    before anything is compiled.

    Args:
        folder: Cache folder; by default JAX_COMPILATION_CACHE_DIR, else a folder in the
            user's cache.

    Returns:
        The absolute path of the folder. None if there is none on this machine:
        JAX_ENABLE_COMPILATION_CACHE=0 switched the cache off, JAX_COMPILATION_CACHE_DIR
        is an address like "gs://...", or the folder cannot be written, which gives one
        `CompilationCacheWarning`.
    """
    if not jax.config.values["jax_enable_compilation_cache"]:
        return None
    chosen = str(folder or jax.config.values["jax_compilation_cache_dir"] or "")
    if "://" in chosen:
        return None  # JAX handles addresses itself
    usual = platformdirs.user_cache_path("softcal_jax", appauthor=False) / "jax"
    folder = (Path(chosen) if chosen else usual).absolute()
    problem = _problem_of(folder)
    if problem is not None:
        # Otherwise JAX would try, and warn, for every single program.
        jax.config.update("jax_enable_compilation_cache", False)
        warnings.warn(
            f"compiled programs are not kept, so that every run compiles them anew: "
            f"{folder} cannot be written ({problem}). Name another folder in "
            "JAX_COMPILATION_CACHE_DIR, or set JAX_ENABLE_COMPILATION_CACHE=0.",
            CompilationCacheWarning,
            stacklevel=2,
        )
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
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
    found = re.match(_UNREADABLE, message)
    folder = jax.config.values["jax_compilation_cache_dir"]
    if found is None or folder is None:
        return None
    program = found[1]
    for entry in Path(folder).glob(f"{glob.escape(program)}-*-cache"):
        entry.unlink(missing_ok=True)
    return (
        f"the compiled program {program} on the disk was damaged; it is compiled again."
    )


_UNREADABLE = r"Error reading persistent compilation cache entry for '(.+?)':"
"""Pattern of the beginning of JAX's warning, with the name of the program."""


def _problem_of(folder: Path) -> str | None:
    """Create a folder and say why it cannot be written to; None if it can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return None
    except OSError as error:
        return error.strerror or str(error)
