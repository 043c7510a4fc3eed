"""Strict numerics for every test: float64, no promotion, checked annotations."""

import atexit
import gc
import os
import signal
import tempfile
from importlib.metadata import version
from pathlib import Path

# Before JAX is imported, and for the processes that tests start: what one module has
# compiled the others need not, and nothing is left in the user's cache. Who names a
# folder of his own keeps the programs there.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    _PROGRAMS = tempfile.TemporaryDirectory(prefix="softcal_jax_tests_")
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _PROGRAMS.name
# Most of the time goes into compiling programs that run for milliseconds. One program
# is not compiled in many parts at once, since other tests want the cores; and nothing
# is moved out of loops, which takes a fifth of the time for Newton's.
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1 "
    "--xla_disable_hlo_passes=while-loop-invariant-code-motion"
    # XLA ends the process at a flag that it does not know.
    + " --xla_cpu_use_fusion_emitters=false"
    * version("jax").startswith(("0.10.", "0.11.0")),
)

# With as many workers as cores, a second thread of PARDISO or NumPy waits for its turn
# on a core, and may spin meanwhile.
os.environ.setdefault("MKL_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jax
import jaxtyping
import pytest
import typechecking

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
# Nobody reads which lines of Python an operation of a compiled program comes from.
jax.config.update("jax_traceback_in_locations_limit", 0)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
# And some of it into a search for garbage among what has been traced.
gc.set_threshold(200_000, 20, 100)
# What is left at the end goes with the process.
atexit.register(gc.freeze)

# A process that a script starts in the background ignores Ctrl-C, which tests raise.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Here, because it must come before the first import of the package.
typechecking.install()


MOST_MAPS = 20_000
"""Memory maps of a process from which compiled programs are forgotten.

A thousand programs can take as many, and 4 GB with the rest; with 30 000 maps a worker
took 7 GB.
"""


@pytest.fixture(scope="module", autouse=True)
def _forget_compiled_programs():
    """Stay below the 65 530 memory maps that Linux grants a process.

    Until then modules share what is compiled and traced.
    """
    yield
    maps = Path("/proc/self/maps")
    if not maps.exists() or maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()


@pytest.fixture(scope="session", autouse=True)
def one_sample_per_pixel():
    """Bodies are drawn faster; with all samples, where a test asks for it."""
    from softcal_jax.plotting import _scene

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_scene, "_SMOOTHING", "msaa")
        yield


@pytest.fixture
def unchecked():
    """Annotations off, as a user has it: wrong shapes meet the package's messages."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)
