"""Setup of a process that runs trials."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version

import jax

from softcal_jax._compilation_cache import use_compilation_cache

_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@dataclass(frozen=True)
class WorkerSetup:
    """Settings with which a worker computes like the process that runs the sweep.

    Attributes:
        x64: Whether JAX computes in float64.
        version: Version of this package.
    """

    x64: bool
    version: str

    @classmethod
    def of_this_process(cls) -> "WorkerSetup":
        """Return the setup that makes a worker compute like this process."""
        return cls(bool(jax.config.read("jax_enable_x64")), version("softcal-jax"))

    def apply(self) -> None:
        """Set up the process that calls it.

        Raises:
            RuntimeError: If it has another version of this package.
        """
        here = version("softcal-jax")
        if here != self.version:
            raise RuntimeError(
                f"the worker has softcal_jax {here}, the sweep {self.version}: rows "
                "would not belong together. Install the same version on both."
            )
        jax.config.update("jax_enable_x64", self.x64)
        use_compilation_cache()


@contextmanager
def threads_of_children(n: int) -> Iterator[None]:
    """Make processes that are started inside use n threads each.

    The number must be in their environment before they load anything. It changes how
    sums are rounded, so it is the same however many workers there are.
    """
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, str(n)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
