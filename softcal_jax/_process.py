"""What a process must be like for JAX to compute in it."""

import os

import jax

_first: list[int] = []
"""Id of the process that first computed here; a forked child inherits the list."""


def check_process() -> None:
    """Raise unless JAX can compute here, and in float64.

    In float32 equilibria do not converge. A child that was forked lacks the threads
    of JAX and of the sparse solver: a computation would wait for them for ever.
    """
    if not jax.config.read("jax_enable_x64"):
        raise ValueError(
            "softcal_jax needs float64, but JAX is in float32. Put "
            '`jax.config.update("jax_enable_x64", True)` at the top of your program, '
            "or set JAX_ENABLE_X64=1."
        )
    pid = os.getpid()
    if not _first:
        _first.append(pid)
    if _first[0] != pid:
        raise RuntimeError(
            f"this process ({pid}) was forked from one in which softcal_jax had "
            f"computed ({_first[0]}), whose threads it lacks. Start processes with "
            '`multiprocessing.get_context("spawn")`, which a ProcessPoolExecutor takes '
            'as `mp_context`, or with joblib\'s "loky".'
        )
