"""Where compiled programs are kept from one process to the next."""

from pathlib import Path

import jax
import platformdirs


def use_compilation_cache(folder: Path | None = None) -> Path:
    """Keep compiled programs on disk, for this process and those after it.

    Args:
        folder: Where; by default where JAX has been told to
            (`JAX_COMPILATION_CACHE_DIR`), else in the user's cache folder.

    Returns:
        The folder. `JAX_ENABLE_COMPILATION_CACHE=false` leaves it unused.
    """
    told = getattr(jax.config, "jax_compilation_cache_dir", None)
    if folder is None and told:
        return Path(told)
    if folder is None:
        folder = platformdirs.user_cache_path("softcal_jax") / "jax"
    jax.config.update("jax_compilation_cache_dir", str(folder))
    # By default what compiles within a second is not kept; a program has many of these.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    return folder
