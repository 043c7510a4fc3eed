"""Cold start: import of the package, and `softcal demo` without any cache.

Every run is a process of its own, with a new home for caches and no compilation cache
of JAX. The import is timed inside the process, after one that is not counted, so the
files come from memory. The parts of the demo are those that its `result.json` reports.
"""

import json
import re
import statistics
import sys
import tempfile
import time
from pathlib import Path

from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._timing import run_process

IMPORTS, DEMOS = 7, 3
GOALS = {"demo_cold_s": Goal("at most", 60.0)}

_TIMED_IMPORT = (
    "import time; begin = time.perf_counter(); import {}; "
    "print(time.perf_counter() - begin)"
)


def run(options: Options) -> Outcome:
    """Imports, then demos."""
    samples: dict[str, list[float]] = {}
    options.say("imports")
    # JAX comes with the package; what it takes alone is the part that is not ours.
    for module in ("softcal_jax", "jax"):
        times = [_import_seconds(module) for _ in range(IMPORTS + 1)]
        samples["import_s" if module == "softcal_jax" else "import_jax_s"] = times[1:]
    for i in range(DEMOS):
        options.say(f"softcal demo, {i + 1} of {DEMOS}")
        for name, seconds in _cold_demo().items():
            samples.setdefault(name, []).append(seconds)
    figures: dict[str, Figure] = {
        name: statistics.median(times) for name, times in samples.items()
    }
    rows = [[name, f"{value:.2f}"] for name, value in figures.items()]
    table = Table("Cold start, medians", ["part", "s"], rows)
    return Outcome(figures, samples, GOALS, [table])


def _import_seconds(module: str) -> float:
    command = [sys.executable, "-c", _TIMED_IMPORT.format(module)]
    with tempfile.TemporaryDirectory() as home:
        return float(run_process(command, _cold(home)))


def _cold_demo() -> dict[str, float]:
    """Wall time of a demo, and its own account of it [s]."""
    program = Path(sys.executable).with_name("softcal")
    if not program.exists():
        raise FileNotFoundError(
            f"{program} does not exist: install the package into this environment."
        )
    with tempfile.TemporaryDirectory() as home:
        results = Path(home) / "demo"
        begin = time.perf_counter()
        run_process([str(program), "demo", "-o", str(results)], _cold(home))
        wall = time.perf_counter() - begin
        told = json.loads((results / "result.json").read_text(encoding="utf-8"))
    parts = told["timing_s"].items()
    return {"demo_cold_s": wall, **{_part(name): seconds for name, seconds in parts}}


def _part(name: str) -> str:
    """Name of the figure for a part of the demo."""
    return f"demo_{re.sub(r'[^a-z0-9]+', '_', name.lower())}_s"


def _cold(home: str) -> dict[str, str]:
    """Environment without anything kept from earlier runs."""
    return {
        "XDG_CACHE_HOME": home,
        "MPLCONFIGDIR": home,  # matplotlib lists the fonts once, which takes a second
        "JAX_ENABLE_COMPILATION_CACHE": "false",
        "JAX_COMPILATION_CACHE_DIR": "",
    }
