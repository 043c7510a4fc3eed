"""Malformed inputs through the command line: what is not a clear refusal?"""

import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from benchmarks._malformed_run import names
from benchmarks._problem import Figure
from benchmarks._timing import ROOT, run_process

HANGS_S = 120.0
"""Time without an end after which an input counts as one that hangs [s]."""

MOST_GB = 4.0

_MODULE = [sys.executable, "-m", "benchmarks._malformed_run"]


def run(count: int, say: Callable[[str], None]) -> tuple[dict[str, Figure], list[str]]:
    """Try so many inputs, of all kinds in turn.

    Returns:
        The figures, and a line for each input that was not refused as it should be.
    """
    counts: Counter[str] = Counter(dict.fromkeys(_COUNTED, 0))
    lines: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        say("malformed_inputs: a project, its checkpoint and its sweep")
        run_process([*_MODULE, folder])
        for outcome in _tried(Path(folder), count):
            if outcome["index"] % 100 == 0:
                say(f"malformed_inputs: {outcome['index']} of {count}")
            wrong = faults(outcome)
            counts.update(wrong)
            if wrong:
                lines.append(f"{', '.join(wrong)}: {_described(outcome)}")
    figures: dict[str, Figure] = {**counts, "kinds": min(count, len(names()))}
    return {f"malformed_inputs_{name}": value for name, value in figures.items()}, lines


_COUNTED = ("tracebacks", "hangs", "over_4_gb", "accepted_silently")


def faults(outcome: dict[str, Any]) -> list[str]:
    """What is wrong with the end of an input, by names of figures."""
    if outcome.get("hangs"):
        return ["hangs"]
    checks = {
        "tracebacks": bool(outcome["traceback"]),
        "over_4_gb": outcome["peak_gb"] > MOST_GB,
        "accepted_silently": outcome["silent"],
    }
    return [name for name, wrong in checks.items() if wrong]


def _described(outcome: dict[str, Any]) -> str:
    last = (outcome.get("traceback") or outcome.get("said") or "").strip().splitlines()
    words = " ".join(outcome.get("words", []))
    end = last[-1][:300] if last else ""
    return f"input {outcome['index']}, {outcome['kind']}: softcal {words}: {end}"


def _tried(folder: Path, count: int) -> Iterator[dict[str, Any]]:
    """What came of each input; a process that hangs or dies is followed by another."""
    start = 0
    while start < count:
        command = [*_MODULE, str(folder), str(start), str(count)]
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=ROOT,
            env={**os.environ, "COLUMNS": "100"},
        )
        try:
            for line in _lines(process):
                if line.startswith("{"):
                    outcome = json.loads(line)
                    start = outcome["index"] + 1
                    yield outcome
        finally:
            process.kill()
            process.wait()
        if start < count:
            kind = names()[start % len(names())]
            yield {"index": start, "kind": kind, "hangs": True}
            start += 1


def _lines(process: subprocess.Popen[str]) -> Iterator[str]:
    """Lines that a process prints, until it ends or is silent for too long."""
    said: queue.Queue[str] = queue.Queue()

    def listen(stdout: IO[str]) -> None:
        for line in stdout:
            said.put(line)
        said.put("")

    assert process.stdout is not None
    threading.Thread(target=listen, args=(process.stdout,), daemon=True).start()
    with suppress(queue.Empty):
        while line := said.get(timeout=HANGS_S):
            yield line
