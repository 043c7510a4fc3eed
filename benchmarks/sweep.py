"""Calibrations per hour of a sweep, with one and with two worker processes.

The beam of Sec. V: 525 nodes, print plane upright, four configurations, six parameters,
one start and a draw of noise per trial. The sweep runs twice with an empty folder:
with one worker and nothing compiled before, then with two that find what the first one
compiled. A rate counts from when every worker has ended its first trial, since that one
compiles; the wait for it is a figure of its own. Rows must be the same, bit for bit.

The same sweep with one worker of the commit `BEFORE` takes turns with this one, so that
their ratio does not depend on the day. Last, how many rows a second are written where
the trials take no time: of a whole sweep, and of parts of ten million planned trials.
"""

import os
import pickle
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._timing import ROOT, at_home, ratio, run_process
from benchmarks.compile import tree_before
from softcal_jax.sweeps import (
    Progress,
    SweepResult,
    Trial,
    grid,
    load_sweep,
    run_sweep,
)

TRIALS = 40
"""Trials of each sweep."""

QUICK_TRIALS = 20_000
"""Trials that take no time."""

PLANNED, PARTS_RUN, PART_TRIALS = 10_000_000, 100, 1_000
"""Trials of a sweep in parts, the parts of it that are run, and the trials of each."""

ROUNDS, ROUND_TRIALS = 2, 20
"""Rounds of this commit and the one before, and trials of each sweep in them."""

GOALS = {
    "two_workers_over_one": Goal("at least", 1.7),
    "trials_per_core_hour_over_before": Goal("at least", 1.8),
    "rows_per_second_limit": Goal("at least", 2000),
    "rows_that_differ": Goal("at most", 0),
    "not_converged": Goal("at most", 0),
}

PROJECT = """\
name = "anisotropic_beam"

[settings]
starts = 1

[mesh]
beam = { size = "(150, 15, 15) mm", cells = [10, 2, 2] }

[material]
law = "corotational"
elasticity = "reduced-transverse-isotropic"
E_t = "700 kPa"
E_l = "400 kPa"
nu = 0.3
theta = "0 deg"
print_plane = "xy"
density = "948.148 kg/m^3"

[control_points.ends]
positions = { "CP 1" = "(0, 7.5, 7.5) mm", "CP 2" = "(150, 7.5, 7.5) mm" }

[[parameters]]
field = "E_t"
control_points = "ends"
lower = "50 kPa"
upper = "2 MPa"

[[parameters]]
field = "E_l"
control_points = "ends"
lower = "50 kPa"
upper = "2 MPa"

[[parameters]]
field = "theta"
control_points = "ends"
lower = "-90 deg"
upper = "90 deg"
S = "1 rad"

[parameter_space]
axes = [["E_l", "E_t", "theta"]]

[markers]
std = "0.01 mm"

[markers.positions]
right = "(150, 7.5, 7.5) mm"
left = "(0, 7.5, 7.5) mm"

[shared]
gravity = "(0, -9.81, 0) m/s^2"
supports = [{ group = "x_min" }]
markers = ["right"]

[[configurations]]
name = "1"

[[configurations]]
name = "2"
gravity = { size = "9.81 m/s^2", direction = [0, -1, 1] }

[[configurations]]
name = "3"
gravity = "(0, 0, 9.81) m/s^2"

[[configurations]]
name = "4"
supports = [{ group = "x_max" }]
markers = ["left"]
"""

SWEEP = """\
project = "project.toml"

[axes]
noise = {{ count = {} }}

[truth]
"E_t of CP 1" = "900 kPa"
"E_t of CP 2" = "600 kPa"
"E_l of CP 1" = "300 kPa"
"E_l of CP 2" = "200 kPa"
"theta of CP 1" = "20 deg"
"theta of CP 2" = "-35 deg"
"""


class Swept(NamedTuple):
    """One run of the sweep.

    Attributes:
        result: Its rows.
        ended: When each row was written, since the beginning [s].
        began: When every worker had ended its first trial [s].
        bytes_out: Size of what a worker is sent for a trial.
        bytes_back: Size of the row that it sends back.
        bytes_kept: Size of the folder.
    """

    result: SweepResult
    ended: list[float]
    began: float
    bytes_out: int
    bytes_back: int
    bytes_kept: int

    @property
    def per_hour(self) -> float:
        """Rows per hour from then on."""
        late = [t for t in self.ended if t > self.began]
        return 3600.0 * len(late) / (self.ended[-1] - self.began)


def run(options: Options) -> Outcome:
    """The sweep with one worker, then with two."""
    with TemporaryDirectory() as home, _cache(Path(home) / "jax"):
        swept = {}
        for workers in (1, 2):
            options.say(f"{TRIALS} trials with {workers} worker(s)")
            swept[workers] = sweep(Path(home), workers)
        programs = (Path(home) / "jax").rglob("*-cache")
        compiled_mb = sum(path.stat().st_size for path in programs) / 1e6
    rates = rates_in_turn(options)
    one, two = swept[1], swept[2]
    figures: dict[str, Figure] = {
        "trials_per_hour_1_worker": one.per_hour,
        "trials_per_hour_2_workers": two.per_hour,
        "core_hours_of_ten_million": 1e7 / one.per_hour,
        "two_workers_over_one": two.per_hour / one.per_hour,
        "first_row_compiling_s": one.ended[0],
        "first_row_compiled_before_s": two.ended[0],
        "rows_that_differ": differing(one.result, two.result),
        "not_converged": TRIALS - len(two.result.of_state("converged")),
        "bytes_to_a_worker_per_trial": one.bytes_out,
        "bytes_from_a_worker_per_trial": one.bytes_back,
        "folder_bytes_per_row": one.bytes_kept / TRIALS,
        "trials_per_core_hour_over_before": ratio(rates["before"], rates["now"]),
        "rows_per_second_limit": rows_per_second(QUICK_TRIALS),
        "part_rows_per_second": parts_per_second(),
        "compiled_programs_mb": compiled_mb,
    }
    picture = options.folder() / "sweep.png"
    plot(list(swept.values()), picture)
    options.say(f"picture: {picture}")
    rows = [
        [str(n), f"{s.per_hour:.0f}", f"{s.ended[0]:.1f}", f"{s.ended[-1]:.1f}"]
        for n, s in swept.items()
    ]
    columns = ["workers", "trials per hour", "first row [s]", "all rows [s]"]
    table = Table(f"A sweep of {TRIALS} calibrations", columns, rows)
    samples = {f"ended_{n}_workers_s": s.ended for n, s in swept.items()}
    return Outcome(figures, samples, GOALS, [table])


@contextmanager
def _cache(folder: Path) -> Iterator[None]:
    """Worker processes keep what they compile in a folder that is empty at first."""
    name = "JAX_COMPILATION_CACHE_DIR"
    before = os.environ.get(name)
    os.environ[name] = str(folder)
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def sweep(folder: Path, workers: int, trials: int = TRIALS) -> Swept:
    """Run the sweep in a folder, with rows of its own."""
    (folder / "project.toml").write_text(PROJECT)
    path = folder / "sweep.toml"
    path.write_text(SWEEP.format(trials))
    loaded = load_sweep(path)
    ended: list[float] = []
    first: dict[str, float] = {}

    def progress(now: Progress) -> None:
        if now.row is not None:
            ended.append(time.perf_counter() - begin)
            first.setdefault(now.row["worker"], ended[-1])

    begin = time.perf_counter()
    rows = folder / f"{workers}"
    result = loaded.run(rows, workers=workers, progress=progress)
    return Swept(
        result,
        ended,
        max(first.values()),
        len(pickle.dumps((loaded.function, Trial(loaded.points[0])))),
        len(pickle.dumps(result.rows[0])),
        sum(file.stat().st_size for file in rows.iterdir()),
    )


def rows_per_second(trials: int) -> float:
    """Rate of a sweep in this process whose trials take no time."""
    points = grid({"i": range(trials)})
    with TemporaryDirectory() as folder:
        begin = time.perf_counter()
        run_sweep(_nothing, points, Path(folder), workers=0)
        return trials / (time.perf_counter() - begin)


def parts_per_second() -> float:
    """Rate of parts of a large sweep, whose trials take no time."""
    points = grid({"i": range(PLANNED // PART_TRIALS), "j": range(PART_TRIALS)})
    of = len(points) // PART_TRIALS
    with TemporaryDirectory() as folder:
        begin = time.perf_counter()
        for k in range(0, of, of // PARTS_RUN):
            run_sweep(_nothing, points, folder, part=(k, of), workers=0)
        seconds = time.perf_counter() - begin
    return PARTS_RUN * PART_TRIALS / seconds


def rates_in_turn(options: Options) -> dict[str, list[float]]:
    """Seconds per trial of one worker, of this commit and of `BEFORE`."""
    seconds: dict[str, list[float]] = {"now": [], "before": []}
    with tree_before() as tree, TemporaryDirectory() as parent:
        for i in range(ROUNDS):
            for name, root in (("now", ROOT), ("before", tree)):
                options.say(f"one worker, {name}, {i + 1} of {ROUNDS}")
                folder = Path(parent) / name / str(i)
                folder.mkdir(parents=True)
                command = [sys.executable, "-c", _RATE, str(folder), str(ROUND_TRIALS)]
                environment = at_home(str(folder.parent), root)
                output = run_process(command, environment, root)
                seconds[name].append(3600.0 / float(output.splitlines()[-1]))
    return seconds


_RATE = """
import sys
from pathlib import Path
import jax
jax.config.update("jax_enable_x64", True)
from benchmarks.sweep import sweep
if __name__ == "__main__":
    print(sweep(Path(sys.argv[1]), 1, int(sys.argv[2])).per_hour)
"""


def _nothing(trial: Trial) -> dict[str, float]:
    return {"i": float(trial["i"])}


def differing(one: SweepResult, other: SweepResult) -> int:
    """How many rows are not the same in two results."""
    columns = [*one.axes, "state", "reason", *one.figures]
    pairs = (result.table.select(columns).to_pylist() for result in (one, other))
    return sum(row != again for row, again in zip(*pairs, strict=True))


def plot(swept: Sequence[Swept], path: Path) -> None:
    """Rows against time."""
    from matplotlib.figure import Figure as Drawing

    from softcal_jax.plotting._figure import SERIES

    drawing = Drawing(figsize=(9.0, 5.5), dpi=100, layout="constrained")
    axes = drawing.subplots()
    for n, (curve, colour) in enumerate(zip(swept, SERIES, strict=False), start=1):
        label = f"{n} worker{'s' * (n > 1)}: {curve.per_hour:.0f} trials per hour"
        if n == 1:
            label += ", nothing compiled before"
        ended, counts = [0.0, *curve.ended], range(len(curve.ended) + 1)
        axes.step(ended, counts, where="post", color=colour, lw=2, label=label)
    most = max(len(curve.ended) for curve in swept)
    axes.set(xlim=(0, None), ylim=(0, 1.25 * most))  # room for the legend
    axes.set_xlabel("time [s]", fontsize=14)
    axes.set_ylabel("rows in the folder", fontsize=14)
    axes.tick_params(labelsize=12)
    axes.grid(True, color="#dddddd", lw=0.8)
    axes.legend(fontsize=13, loc="upper left")
    axes.set_title("Calibrations of a 525-node beam in a sweep", fontsize=16)
    drawing.savefig(path, format="png")
