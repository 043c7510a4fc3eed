"""Which programs are compiled, while something runs."""

import jax


class Compilations:
    """Context that notes the programs that JAX compiles, or takes from its folder.

    A program that is in memory already is not among them.

    Attributes:
        programs: Their names, in the order in which they ended.
        seconds: How long each took [s].
    """

    def __init__(self):
        self.programs: list[str] = []
        self.seconds: list[float] = []

    def __enter__(self) -> "Compilations":
        jax.monitoring.register_event_duration_secs_listener(self._listen)
        return self

    def __exit__(self, *_) -> None:
        jax.monitoring.unregister_event_duration_listener(self._listen)

    def _listen(self, event: str, duration_secs: float, **about) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            self.programs.append(str(about.get("fun_name")))
            self.seconds.append(duration_secs)
