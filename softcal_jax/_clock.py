"""Wall time of a computation, and the part of it in which JAX compiles."""

import time

import jax


class Clock:
    """Context whose `seconds` are its wall time, "compile" by JAX and "solve" [s].

    JAX reports the duration of each trace, lowering and compilation when it ends. Those
    that overlap are counted once, as "compile" even where a solve runs beside them.
    """

    def __init__(self):
        self._compiling: list[tuple[float, float]] = []
        self._end: float | None = None

    def __enter__(self) -> "Clock":
        self._begin = time.perf_counter()
        jax.monitoring.register_event_duration_secs_listener(self._listen)
        return self

    def __exit__(self, *_) -> None:
        jax.monitoring.unregister_event_duration_listener(self._listen)
        self._end = time.perf_counter()

    @property
    def seconds(self) -> dict[str, float]:
        """Wall time so far, or at the end of the context [s]."""
        elapsed = (self._end or time.perf_counter()) - self._begin
        compiling, reached = 0.0, self._begin
        for begin, end in sorted(self._compiling):
            compiling += max(0.0, end - max(begin, reached))
            reached = max(reached, end)
        return {"compile": compiling, "solve": elapsed - compiling}

    def _listen(self, event: str, duration_secs: float, **_) -> None:
        if event.startswith("/jax/core/compile/"):
            now = time.perf_counter()
            self._compiling.append((now - duration_secs, now))
