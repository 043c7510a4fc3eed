"""Cold start and second start: imports, `softcal demo`, and the paper's beam.

Every run is a process of its own. A cold one has a new home for caches; a warm one has
that of the run before, with the compiled programs and fonts that it left there. The
import is timed inside the process, after one that is not counted, so the files come
from memory. The parts of the demo are those that its `result.json` reports. The beam is
that of Sec. V, 525 nodes, four poses: from the start of its process to its first
result, the equilibria of the poses, and to the end of its calibration. So the trunk,
with two cables, a rigid cap and six poses.

The same starts of the commit `BEFORE`, the last one before error budgets became a solve
of their own, take turns with these, so that ratios do not depend on the day. The answer
is there when the line "Preliminary values" is printed; before, when the demo has ended.

Then a gradient through an equilibrium that is called eagerly in a process of its own,
and what second calls compile; what the error of the mesh takes beside a fit. Last, two
jobs on the command line: `softcal calibrate` of the beam with its search, intervals and
pictures, cold and then warm, in seconds and over the time of its fit; and a sweep of 30
trials with nothing compiled before. Of the demo, too, the time over that of its fit.
"""

import json
import re
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks._jobs import calibrations, fit_seconds, swept
from benchmarks._mesh_error import ROBOTS
from benchmarks._paper import CELLS, Cells
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._timing import ROOT, at_home, run_process

BEFORE = "c57df9d"
COUNTS = {"imports": 7, "starts": 3, "gradients": 1, "mesh_errors": 1, "jobs": 1}
GOALS = {
    "demo_cold_s": Goal("at most", 60.0),
    "demo_cold_over_before": Goal("at most", 0.35),
    "demo_warm_over_before": Goal("at most", 0.2),
    "answer_cold_over_before": Goal("at most", 0.25),
    "answer_warm_over_before": Goal("at most", 0.12),
    "beam_cold_over_before": Goal("at most", 0.5),
    "trunk_cold_over_before": Goal("at most", 0.4),
    "tracing_warm_over_before": Goal("at most", 0.25),
    "mesh_error_over_fit": Goal("at most", 0.15),
    "mesh_error_memory_over_fit": Goal("at most", 1.5),
    "second_eager_call_compiles": Goal("at most", 0),
    "recompilations_after_first_step": Goal("at most", 0),
    "beam_programs": Goal("at most", 40),
    "beam_programs_not_kept": Goal("at most", 0),
    "job_warm_s": Goal("at most", 40.0),
    "job_warm_over_fit": Goal("at most", 6.0),
    "sweep_s": Goal("at most", 150.0),
}

_TIMED_IMPORT = (
    "import time; begin = time.perf_counter(); import {}; "
    "print(time.perf_counter() - begin)"
)

_DEMO = """
import runpy, sys, time
begin = time.perf_counter()
import jax
times, spans = {"answer": None, "tracing": 0.0}, []
parts = ("trace_duration", "module_duration", "cache_retrieval_time_sec")
def add(event, seconds, **_):
    if event.endswith(parts):
        spans.append((time.perf_counter() - seconds, time.perf_counter()))
jax.monitoring.register_event_duration_secs_listener(add)
write = sys.stdout.write
def seen(text):
    if "Preliminary values" in text:
        times["answer"] = time.perf_counter() - begin
    return write(text)
sys.stdout.write = seen
sys.argv[0] = "softcal"
try:
    runpy.run_module("softcal_jax", run_name="__main__")
except SystemExit as end:
    assert not end.code, end.code
import json
times["total"] = time.perf_counter() - begin
until = 0.0
for first, last in sorted(spans):  # of several threads, and one in another
    times["tracing"] += max(0.0, last - max(first, until))
    until = max(until, last)
write("\\n" + json.dumps(times))
"""
"""A demo that tells when its answer was there, and for how long anything was traced,
lowered or read back [s]."""

COUNTED = (
    "recompilations_after_first_step",
    "beam_programs",
    "beam_programs_not_kept",
    "second_eager_call_compiles",
)
"""What is counted, not timed: of all runs the worst."""


Say = Callable[[str], None]
Found = tuple[dict[str, list[float]], dict[str, Figure]]
"""Samples of a part, and figures that are no median of samples."""


def run(options: Options) -> Outcome:
    """Imports, then starts of demo and beam, cold and warm in turn."""
    samples: dict[str, list[float]] = {}
    figures: dict[str, Figure] = {}
    for part, count in (options.counts or COUNTS).items():
        times, more = _PARTS[part](count, options.say)
        samples |= times
        figures |= more
    figures |= {
        name: int(max(values)) if name in COUNTED else statistics.median(values)
        for name, values in samples.items()
    }
    seconds = {name: times for name, times in samples.items() if name not in COUNTED}
    goals = {name: goal for name, goal in GOALS.items() if name in figures}
    return Outcome(figures, seconds, goals, [_table(figures)])


def imports(count: int, say: Say) -> Found:
    """Seconds of an import; JAX comes with the package, and is the part not ours."""
    say("imports")
    times = lambda module: [_import_seconds(module) for _ in range(count + 1)][1:]
    return {"import_s": times("softcal_jax"), "import_jax_s": times("jax")}, {}


def starts(count: int, say: Say) -> Found:
    """Starts of demo, beam and trunk, in turn with those of `BEFORE`."""
    samples: dict[str, list[float]] = {}
    before: dict[str, list[float]] = {}
    with tree_before() as tree:
        for i in range(count):
            say(f"softcal demo, the beam and the trunk, {i + 1} of {count}")
            for folder, times in ((ROOT, samples), (tree, before)):
                _add(times, demo_starts(folder) | beam_starts(CELLS, folder))
                _add(times, trunk_starts(folder))
    return samples, over_before(samples, before)


def gradients(count: int, say: Say) -> Found:
    """First gradients in processes of their own, and what second calls compile."""
    samples: dict[str, list[float]] = {}
    for i in range(count):
        say(f"first gradient, {i + 1} of {count}")
        _add(samples, eager_starts())
    return samples, {}


def _add(samples: dict[str, list[float]], values: dict[str, float]) -> None:
    for name, value in values.items():
        samples.setdefault(name, []).append(value)


def _table(figures: dict[str, Figure]) -> Table:
    """Cold beside warm."""
    rows = [
        [
            name.replace("_cold_", "_"),
            f"{value:.2f}",
            f"{figures[name.replace('_cold_', '_warm_')]:.2f}",
        ]
        for name, value in figures.items()
        if "_cold_" in name and name.endswith("_s")
    ]
    return Table("Starts, medians", ["until", "cold [s]", "warm [s]"], rows)


def _import_seconds(module: str) -> float:
    command = [sys.executable, "-c", _TIMED_IMPORT.format(module)]
    with tempfile.TemporaryDirectory() as home:
        return float(run_process(command, at_home(home)))


@contextmanager
def tree_before() -> Iterator[Path]:
    """Check `BEFORE` out beside this tree, for as long as it is needed."""
    with tempfile.TemporaryDirectory() as parent:
        tree = Path(parent) / "before"
        run_process(["git", "worktree", "add", "--detach", str(tree), BEFORE])
        try:
            yield tree
        finally:
            run_process(["git", "worktree", "remove", "--force", str(tree)])


def over_before(
    now: dict[str, list[float]], before: dict[str, list[float]]
) -> dict[str, Figure]:
    """Ratios of medians to those of `BEFORE`."""
    median = lambda samples, name: statistics.median(samples[name])
    ratio = lambda name, old: median(now, name) / median(before, old)
    figures: dict[str, Figure] = {
        f"{what}_{start}_over_before": ratio(f"{what}_{start}_s", f"demo_{start}_s")
        for what in ("demo", "answer")
        for start in ("cold", "warm")
    }
    for name, what in (
        ("beam_cold", "beam_cold_calibration_s"),
        ("trunk_cold", "trunk_cold_calibration_s"),
        ("tracing_warm", "tracing_warm_s"),
    ):
        figures[f"{name}_over_before"] = ratio(what, what)
    return figures


def demo_starts(folder: Path = ROOT) -> dict[str, float]:
    """Wall times of a demo, cold and then warm, and its own account of them [s]."""
    figures: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as home:
        for start in ("cold", "warm"):
            results = Path(home) / start
            command = [sys.executable, "-c", _DEMO, "demo", "-o", str(results)]
            said = json.loads(
                run_process(command, at_home(home, folder), folder).splitlines()[-1]
            )
            figures[f"demo_{start}_s"] = said["total"]
            figures[f"answer_{start}_s"] = said["answer"] or said["total"]
            figures[f"tracing_{start}_s"] = said["tracing"]
            result = json.loads((results / "result.json").read_text(encoding="utf-8"))
            for part, seconds in result["timing_s"].items():
                name = re.sub(r"[^a-z0-9]+", "_", part.lower())
                figures[f"demo_{start}_{name}_s"] = seconds
            figures[f"demo_{start}_over_fit"] = said["total"] / fit_seconds(result)
    return figures


def beam_starts(cells: Cells, folder: Path = ROOT) -> dict[str, float]:
    """Times of the beam, cold and then warm [s], and what was compiled.

    Args:
        cells: Cells along, up and across.
        folder: The tree whose package it is.

    Raises:
        RuntimeError: If its calibration does not converge.
    """
    figures: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as home:
        for start in ("cold", "warm"):
            command = [sys.executable, "-m", "benchmarks._first_result"]
            command += [str(time.time()), *map(str, cells)]
            report = json.loads(run_process(command, at_home(home, folder), folder))
            if not report["converged"]:
                raise RuntimeError("the calibration of the beam did not converge.")
            for part in ("first_result", "calibration", "compile"):
                figures[f"beam_{start}_{part}_s"] = report[f"{part}_s"]
            again = "recompilations_after_first_step"
            figures[again] = max(figures.get(again, 0), report[again])
    figures["beam_programs"] = report["programs"]
    figures["beam_programs_not_kept"] = report["programs"] - report["from_disk"]
    return figures


def trunk_starts(folder: Path = ROOT) -> dict[str, float]:
    """Times of a calibration of the trunk, cold and then warm [s].

    Raises:
        RuntimeError: If it does not converge to the modulus of its measurements.
    """
    figures: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as home:
        for start in ("cold", "warm"):
            command = [sys.executable, str(ROOT / "benchmarks" / "_trunk.py")]
            command.append(str(time.time()))
            report = json.loads(run_process(command, at_home(home, folder), folder))
            if not (report["converged"] and report["recovered"]):
                raise RuntimeError("the calibration of the trunk did not converge.")
            figures[f"trunk_{start}_calibration_s"] = report["calibration_s"]
    return figures


def eager_starts() -> dict[str, float]:
    """Time to the first gradient, cold and warm [s], and what a second one compiles."""
    figures: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as home:
        for start in ("cold", "warm"):
            command = [sys.executable, "-m", "benchmarks._eager", str(time.time())]
            report = json.loads(run_process(command, at_home(home)).splitlines()[-1])
            figures[f"first_gradient_{start}_s"] = report["first_gradient_s"]
            again = "second_eager_call_compiles"
            figures[again] = max(figures.get(again, 0), report["second_calls"])
    return figures


def mesh_errors(count: int, say: Say) -> Found:
    """What the error of the mesh takes over the fit, of each robot and the worst."""
    figures: dict[str, Figure] = {}
    for robot in count * ROBOTS:
        say(f"error of the mesh, {robot}")
        command = [sys.executable, "-m", "benchmarks._mesh_error", robot]
        report = json.loads(run_process(command).splitlines()[-1])
        for what, value in report.items():
            for name in (f"mesh_error_{what}", f"{robot}_mesh_error_{what}"):
                figures[name] = max(figures.get(name, 0.0), value)
    return {}, figures


def jobs(count: int, say: Say) -> Found:
    """Calibrations of the beam, and sweeps over it, as a user runs them."""
    samples: dict[str, list[float]] = {}
    figures: dict[str, Figure] = {}
    for i in range(count):
        say(f"softcal calibrate and softcal sweep of the beam, {i + 1} of {count}")
        _add(samples, calibrations())
        seconds, converged = swept()
        _add(samples, {"sweep_s": seconds})
        figures["sweep_trials_converged"] = converged
    return samples, figures


_PARTS = {
    "imports": imports,
    "starts": starts,
    "gradients": gradients,
    "mesh_errors": mesh_errors,
    "jobs": jobs,
}
