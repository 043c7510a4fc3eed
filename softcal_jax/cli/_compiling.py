"""What JAX compiles at the moment, and for how long already."""

import os
import threading
import time
from collections import Counter
from typing import Any

_COMPILE = "/jax/core/compile/"
_BACKEND = f"{_COMPILE}backend_compile_duration"
_FROM_DISK = "/jax/compilation_cache/cache_hits"

NOTICED_S = 0.5
"""Time after which a program that is being made is worth a word [s]."""


class Compiling:
    """Listener of JAX: what is being compiled, from its beginning on.

    JAX tells the beginning of each trace, lowering and compilation as a scalar, and the
    end as a duration. Programs are compiled by several threads at once.
    """

    def __init__(self):
        self._lock = threading.Lock()
        self._open: Counter[tuple[int, str]] = Counter()
        self._since = self._before = 0.0
        self._kept = True
        self._listening = False

    def start(self) -> None:
        """Listen to JAX, once it is imported and its cache is chosen."""
        import jax

        self._kept = bool(
            jax.config.values["jax_enable_compilation_cache"]
            and jax.config.values["jax_compilation_cache_dir"]
        )
        if not self._listening:
            self._listening = True
            jax.monitoring.register_scalar_listener(self._begins)
            jax.monitoring.register_event_duration_secs_listener(self._ends)
            jax.monitoring.register_event_listener(self._found)

    def stop(self) -> None:
        """Listen no more."""
        if self._listening:
            import jax

            self._listening = False
            jax.monitoring.unregister_scalar_listener(self._begins)
            jax.monitoring.unregister_event_duration_listener(self._ends)
            jax.monitoring.unregister_event_listener(self._found)

    def words(self) -> str:
        """Say what is being compiled, and the time of all compiling so far.

        Empty where nothing is, or not for long yet.
        """
        now = time.time()
        with self._lock:
            if not self._open or now - self._since < NOTICED_S:
                return ""
            compiles = any(event == _BACKEND for _, event in self._open)
            seconds = self._before + now - self._since
        only = " (first run only)" if self._kept else ""
        what = f"compiling{only}" if compiles else "preparing a program"
        return f"{what}, {seconds:.0f} s"

    def _begins(self, event: str, value: float, **_: Any) -> None:
        if event.startswith(_COMPILE):
            with self._lock:
                if not self._open:
                    self._since = time.time()
                self._open[threading.get_ident(), event] += 1

    def _ends(self, event: str, duration_secs: float, **_: Any) -> None:
        if event.startswith(_COMPILE):
            self._close((threading.get_ident(), event))

    def _found(self, event: str, **_: Any) -> None:
        """Forget a compilation whose program was read from disk instead."""
        if event == _FROM_DISK:
            self._close((threading.get_ident(), _BACKEND))

    def _close(self, key: tuple[int, str]) -> None:
        with self._lock:
            if key not in self._open:
                return
            self._open[key] -= 1
            if not self._open[key]:
                del self._open[key]
            if not self._open:  # threads that compile at once count once
                self._before += time.time() - self._since


def silence() -> None:
    """Keep what XLA and JAX write for their developers from the user's terminal.

    Call it before JAX is imported. What is set in the environment already is left, so
    that a developer can ask for it: TF_CPP_MIN_LOG_LEVEL, JAX_LOGGING_LEVEL.
    """
    import logging

    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    if not {"JAX_LOGGING_LEVEL", "JAX_LOG_COMPILES"} & set(os.environ):
        for name in ("jax", "jaxlib", "absl"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
