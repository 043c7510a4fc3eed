"""Kills of calibrations and sweeps at random moments: is anything lost or changed?"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks._demo import Variant, copy_demo
from benchmarks._problem import Figure
from benchmarks._timing import ROOT
from softcal_jax._process import available_cores
from softcal_jax.sweeps import read_sweep

SEED = 22
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
TRIALS = 6
"""Trials of each sweep."""

ENDS_S = 300.0
"""Time after which a process counts as one that does not end [s]."""

ORPHANS_S = 20.0
"""Time after which a process that its parent has left behind counts [s]."""

_COUNTED = ("rows_lost", "results_that_differ", "orphans", "refused_to_go_on", "done")


_PROGRAM = """\
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from softcal_jax.cli import main
sys.exit(main())
"""
"""`softcal`, also where a script in the background made its processes ignore Ctrl-C."""


class Ended(NamedTuple):
    """How a command ended.

    Attributes:
        code: Its exit code; negative if a signal ended it.
        said: What it printed.
        orphans: Processes of it that are still there.
        seconds: How long it took [s].
    """

    code: int
    said: str
    orphans: int
    seconds: float


def run(count: int, say: Callable[[str], None]) -> tuple[dict[str, Figure], list[str]]:
    """Kill so many calibrations, and half as many sweeps, and let them go on.

    Returns:
        The figures, and a line for each that did not go on as it should.
    """
    counts: Counter[str] = Counter(dict.fromkeys(_COUNTED, 0))
    lines: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        for kill, n in ((_calibrations, count), (_sweeps, (count + 1) // 2)):
            for outcome, text in kill(home, n, say):
                counts.update(outcome)
                lines += [text] if any(outcome[k] for k in _COUNTED[:-1]) else []
    return {f"kills_{name}": value for name, value in counts.items()}, lines


def _calibrations(home: Path, count: int, say: Callable[[str], None]):
    """Kill calibrations with a checkpoint; each must end where a whole one does."""
    project = _small(home / "calibration")
    command = lambda out, *more: _softcal(
        "calibrate",
        project,
        "-o",
        home / out,
        "--checkpoint",
        home / f"{out}.npz",
        *more,
    )
    _whole(command("compiled"))
    whole = _whole(command("whole"))
    expected = _values(home / "whole")
    moments = np.random.default_rng([SEED, 0]).uniform(0.0, whole.seconds, count)

    def one(i: int) -> tuple[Counter[str], str]:
        kind = SIGNALS[i % len(SIGNALS)]
        say(f"kills: calibration {i} of {count}")
        killed = ended(command(f"{i}"), (moments[i], kind))
        again = ended(command(f"{i}", "--force"))
        went_on = again.code == whole.code
        same = went_on and _values(home / f"{i}") == expected
        shutil.rmtree(home / f"{i}", ignore_errors=True)
        return (
            Counter(
                done=1,
                orphans=killed.orphans + again.orphans,
                refused_to_go_on=not went_on,
                results_that_differ=went_on and not same,
            ),
            f"calibration {i}, {kind.name} after {moments[i]:.2f} s, code "
            f"{killed.code}: {_last(killed)}; then code {again.code}: {_last(again)}",
        )

    with ThreadPoolExecutor(available_cores()) as pool:
        yield from pool.map(one, range(count))


def _small(folder: Path) -> Path:
    """Copy the demo with so few tets that most of its time is what can be cut short."""
    path = copy_demo(folder, Variant((6, 2, 2), "linear", "displacement"))
    text, posts = path.read_text(encoding="utf-8"), r"base_radius = \"[^\"]*\""
    assert len(re.findall(posts, text)) == 1, "the demo has other markers now"
    wide = re.sub(posts, 'base_radius = "30 mm"', text)
    path.write_text(wide, encoding="utf-8")
    return path


def _sweeps(home: Path, count: int, say: Callable[[str], None]):
    """Kill sweeps with two workers; no row may be lost, and all must be the same."""
    project = _small(home / "sweep")
    path = project.with_name("sweep.toml")
    text = f'project = "{project.name}"\n[axes]\nnoise = {{ count = {TRIALS} }}\n'
    path.write_text(text, encoding="utf-8")
    command = lambda name: _softcal(
        "sweep", path, "--workers", "2", "-o", home / f"{name}"
    )
    _whole(command("compiled"))
    whole = _whole(command("whole"))
    expected = _rows(home / "whole")
    random = np.random.default_rng([SEED, 1])
    for i in range(count):
        kind = SIGNALS[i % len(SIGNALS)]
        say(f"kills: sweep {i} of {count}")
        moment, folder = random.uniform(0.0, whole.seconds), home / f"{i}"
        killed = ended(command(f"{i}"), (moment, kind))
        before = _rows(folder) if [*folder.glob("*.parquet")] else {}
        again = ended(command(f"{i}"))
        went_on = again.code == whole.code
        after = _rows(folder) if went_on else {}
        yield (
            Counter(
                done=1,
                rows_lost=len(before.keys() - after.keys()) if went_on else 0,
                orphans=killed.orphans + again.orphans,
                refused_to_go_on=not went_on,
                results_that_differ=went_on and after != expected,
            ),
            f"sweep {i}, {kind.name} after {moment:.2f} s, code {killed.code}: "
            f"{_last(killed)}; then code {again.code}: {_last(again)}",
        )


def _softcal(*words: object) -> list[str]:
    return [sys.executable, "-c", _PROGRAM, *map(str, words)]


def _whole(command: Sequence[str]) -> Ended:
    """Run a command that nothing disturbs.

    Raises:
        RuntimeError: If it fails.
    """
    done = ended(command)
    if done.code not in (0, 1):
        raise RuntimeError(f"{' '.join(command)} ended with {done.code}:\n{done.said}")
    return done


def ended(command: Sequence[str], kill: tuple[float, int] | None = None) -> Ended:
    """Run a command in a session of its own, and send it a signal, if any.

    Args:
        command: Program and arguments.
        kill: When [s], and the signal.
    """
    begin = time.perf_counter()
    with tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen(
            command, stdout=output, stderr=output, cwd=ROOT, start_new_session=True
        )
        if kill is not None:
            moment, number = kill
            try:
                process.wait(moment)
            except subprocess.TimeoutExpired:
                process.send_signal(number)
        try:
            process.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            pass  # it counts as one that is left, below
        seconds = time.perf_counter() - begin
        orphans = _left(process.pid)
        if orphans:
            os.killpg(process.pid, signal.SIGKILL)
        code = process.wait()
        output.seek(0)
        return Ended(code, output.read(), orphans, seconds)


def _left(session: int) -> int:
    """Processes of a session that do not end within some seconds."""
    end = time.monotonic() + ORPHANS_S
    while (there := _members(session)) and time.monotonic() < end:
        time.sleep(0.05)
    return there


def _members(session: int) -> int:
    """Number of processes of a session that run."""
    running = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, *numbers = stat.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue  # it has just ended
        running += int(numbers[2]) == session and state != "Z"
    return running


def _values(out: Path) -> dict[str, float] | None:
    """Values that a calibration found; None if it wrote none."""
    try:
        result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    return {p["name"]: p["value"] for p in result["parameters"]}


def _rows(folder: Path) -> dict[str, dict[str, Any]]:
    """Rows of a sweep by point, less the times and the places."""
    varying = ("seconds", "compile_seconds", "worker", "ended", "traceback")
    rows = read_sweep(folder).rows
    same = lambda row: {name: v for name, v in row.items() if name not in varying}
    return {row["point"]: same(row) for row in rows}


def _last(end: Ended) -> str:
    lines = end.said.strip().splitlines()
    return lines[-1][:300] if lines else "silent"
