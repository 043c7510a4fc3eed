"""Calibrations over and over in one process: what stays? `_leaks CALLS`."""

import contextlib
import gc
import json
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks._demo import COARSE, copy_demo
from benchmarks._problem import Figure
from benchmarks._timing import run_process

ROUNDS = 10
"""Times that each mesh is calibrated."""

WARM = 3
"""Rounds that compile and fill the caches; later ones are measured."""


def run(count: int, say: Callable[[str], None]) -> tuple[dict[str, Figure], list[str]]:
    """Do so many calibrations in a process of its own.

    Returns:
        The figures; memory is fitted as a line over the rounds that are warm.
    """
    say(f"leaks: {count} calibrations of {meshes(count)} meshes")
    command = [sys.executable, "-m", "benchmarks._leaks", str(count)]
    rounds = json.loads(run_process(command).splitlines()[-1])
    warm = rounds[WARM:]
    per_round = float(np.polyfit(range(len(warm)), [r["mb"] for r in warm], 1)[0])
    figures: dict[str, Figure] = {"mb_per_call": per_round / meshes(count)}
    for name in ("maps", "threads", "files"):
        figures[f"more_{name}"] = warm[-1][name] - warm[0][name]
    figures["last_mb"] = warm[-1]["mb"]
    return {f"leaks_{name}": value for name, value in figures.items()}, []


def meshes(count: int) -> int:
    """How many meshes a number of calibrations is of."""
    return max(1, count // ROUNDS)


def held() -> dict[str, float]:
    """What this process holds: memory [MB], maps, threads and open files.

    Of the maps only programs and files count: the allocator's own come and go.
    """
    gc.collect()
    status = Path("/proc/self/status").read_text().splitlines()
    of = dict(line.split(":", 1) for line in status if ":" in line)
    return {
        "mb": int(of["VmRSS"].split()[0]) / 1024.0,
        "maps": sum(map(_is_program_or_file, _maps())),
        "threads": int(of["Threads"]),
        "files": len(os.listdir("/proc/self/fd")),
    }


def _maps() -> list[list[str]]:
    """Fields of each map: addresses, permissions, offset, device, inode, any path."""
    lines = Path("/proc/self/maps").read_text().splitlines()
    return [line.split(maxsplit=5) for line in lines]


def _is_program_or_file(fields: list[str]) -> bool:
    return "x" in fields[1] or fields[4] != "0"


def main() -> None:
    """Calibrate beams of several lengths in turn; print what is held by rounds."""
    import jax

    from softcal_jax._compilation_cache import use_compilation_cache
    from softcal_jax.project import load_project

    jax.config.update("jax_enable_x64", True)
    use_compilation_cache()
    n, rounds = meshes(int(sys.argv[1])), []
    with tempfile.TemporaryDirectory() as folder:
        path = copy_demo(Path(folder) / "project", COARSE)
        for _ in range(ROUNDS):
            for i in range(n):
                project = load_project(
                    path, changes={"mesh.beam.cells": [14 + i, 4, 4]}
                )
                with contextlib.redirect_stdout(sys.stderr):
                    project.calibrate()
            rounds.append(held())
    print(json.dumps(rounds))


if __name__ == "__main__":
    main()
