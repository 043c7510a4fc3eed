"""What a new user meets: import, `softcal check`, the report, the docs, the README.

Each time is that of a process of its own, after one that is not counted, so that files
come from memory and Python has compiled them. The check draws its picture, and each has
a new home for caches: no fonts are listed and no programs kept. The report is that of
`softcal demo`, opened from disk in headless Chromium, which lists what it asks the
network for and the errors of its console. Names of the package load on first use, so
`import_all_s` is what a program pays that uses them.
"""

import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks._browser import visit
from benchmarks._problem import Figure, Goal, Options, Outcome
from benchmarks._timing import ROOT, run_process
from softcal_jax.robots import ready_made_path

COUNTS = {"import": 5, "check": 3, "report": 1, "docs": 1, "readme": 1}
GOALS = {
    "import_s": Goal("at most", 1.0),
    "check_s": Goal("at most", 3.0),
    "check_programs": Goal("at most", 0),
    "report_mb": Goal("at most", 5.0),
    "report_requests": Goal("at most", 0),
    "report_console_errors": Goal("at most", 0),
    "docs_warnings": Goal("at most", 0),
    "readme_lines": Goal("at most", 200),
}


def run(options: Options) -> Outcome:
    """Measure each part."""
    counts = options.counts or COUNTS
    figures: dict[str, Figure] = {}
    samples: dict[str, list[float]] = {}
    if "import" in counts:
        options.say("imports")
        for name, code in (
            ("import_s", "import softcal_jax"),
            ("import_all_s", "from softcal_jax import *"),
        ):
            samples[name] = import_seconds(code, counts["import"])
    if "check" in counts:
        options.say("softcal check")
        samples["check_s"], figures["check_programs"] = check_seconds(counts["check"])
    figures |= {name: statistics.median(times) for name, times in samples.items()}
    if "report" in counts:
        options.say("softcal demo, and its report in a browser")
        with tempfile.TemporaryDirectory() as folder:
            results = Path(folder) / "results"
            run_process([*SOFTCAL, "demo", "-o", str(results)])
            figures |= report_figures(results / "report.html")
    if "docs" in counts:
        options.say("the docs")
        figures["docs_warnings"] = docs_warnings()
    if "readme" in counts:
        text = (ROOT / "README.md").read_text(encoding="utf-8")
        figures["readme_lines"] = len(text.splitlines())
    goals = {name: goal for name, goal in GOALS.items() if name in figures}
    return Outcome(figures, samples, goals)


SOFTCAL = (sys.executable, "-m", "softcal_jax")
"""The command line of this environment."""


def import_seconds(code: str, repeats: int) -> list[float]:
    """Wall times of a statement in new processes, the first one not counted [s].

    Args:
        code: The statement.
        repeats: Number of times.
    """
    timed = f"import time; begin = time.perf_counter()\n{code}\n"
    timed += "print(time.perf_counter() - begin)"
    times = [
        float(run_process([sys.executable, "-c", timed], _COMPILED))
        for _ in range(repeats + 1)
    ]
    return times[1:]


def check_seconds(repeats: int) -> tuple[list[float], int]:
    """Wall times of a check of the demo, and the most programs that one compiled.

    Args:
        repeats: Number of times; one more is not counted.
    """
    times, programs = [], 0
    for _ in range(repeats + 1):
        with tempfile.TemporaryDirectory() as home:
            folder = Path(home)
            picture, kept = folder / "check.png", folder / "jax"
            environment = _COMPILED | {
                "XDG_CACHE_HOME": home,
                "MPLCONFIGDIR": home,
                "JAX_ENABLE_COMPILATION_CACHE": "true",
                "JAX_COMPILATION_CACHE_DIR": str(kept),
            }
            beam = str(ready_made_path("beam"))
            command = [*SOFTCAL, "check", beam, "-o", str(picture)]
            begin = time.perf_counter()
            run_process(command, environment)
            times.append(time.perf_counter() - begin)
            programs = max(programs, len([*kept.glob("*-cache")]))
    return times[1:], programs


_COMPILED = {"PYTHONDONTWRITEBYTECODE": ""}
"""Environment in which Python keeps what it compiles of the modules."""


def report_figures(page: Path) -> dict[str, Figure]:
    """Size of a report, and what it does in a browser.

    Args:
        page: The report.
    """
    seen = visit(page)
    return {
        "report_mb": page.stat().st_size / 1e6,
        "report_requests": len(seen.requests),
        "report_console_errors": len(seen.errors),
    }


def docs_warnings() -> int:
    """Number of warnings with which Sphinx builds the docs.

    Raises:
        RuntimeError: If it does not build them.
    """
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "sphinx", "-q", str(ROOT / "docs"), folder]
        done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"sphinx failed: {done.stderr[-2000:]}")
    return len(re.findall(r"\b(?:WARNING|ERROR): ", done.stderr))
