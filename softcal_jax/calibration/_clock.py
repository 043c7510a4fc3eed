"""Wall time split into compiling and solving."""

import time

import jax


class Clock:
    """Context that splits its wall time into compiling by JAX and everything else.

    JAX reports the duration of each trace, lowering and compilation when it ends;
    nested ones are counted once.

    Attributes:
        seconds: "compile" and "solve", after the context has ended [s].
    """

    def __init__(self):
        self.seconds: dict[str, float] = {}
        self._compiling: list[tuple[float, float]] = []

    def __enter__(self) -> "Clock":
        self._begin = time.perf_counter()
        jax.monitoring.register_event_duration_secs_listener(self._listen)
        return self

    def __exit__(self, *_) -> None:
        jax.monitoring.unregister_event_duration_listener(self._listen)
        compiling, reached = 0.0, self._begin
        for begin, end in sorted(self._compiling):
            compiling += max(0.0, end - max(begin, reached))
            reached = max(reached, end)
        self.seconds = {"compile": compiling, "solve": self.elapsed() - compiling}

    def elapsed(self) -> float:
        """Return the wall time since the context began [s]."""
        return time.perf_counter() - self._begin

    def _listen(self, event: str, duration_secs: float, **_) -> None:
        if event.startswith("/jax/core/compile/"):
            now = time.perf_counter()
            self._compiling.append((now - duration_secs, now))
