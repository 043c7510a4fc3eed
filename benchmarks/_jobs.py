"""Two jobs on the command line: a beam that is calibrated, and a sweep over it.

The beam is that of Sec. V with four poses, 525 nodes, and 0.1 mm of noise: six
parameters that these data hardly tell apart, so the search runs all its starts.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._timing import ROOT, at_home
from softcal_jax.project import load_project
from softcal_jax.sweeps import read_sweep

PROJECT = ROOT / "tests" / "project" / "anisotropic_beam.toml"
TRUTH = {
    "E_t of CP 1": 7.6e5,
    "E_t of CP 2": 6.2e5,
    "E_l of CP 1": 3.6e5,
    "E_l of CP 2": 3.0e5,
    "theta of CP 1": np.deg2rad(20.0),
    "theta of CP 2": np.deg2rad(30.0),
}
STD = 1e-4  # of the noise [m]

SWEEP = """
project = "project.toml"

[axes]
start = { count = 3 }
noise = { count = 10 }
"""

SOFTCAL = (sys.executable, "-m", "softcal_jax")
ENDED = (0, 1, 3)
"""Exit codes of a job that ran to its end, whatever its verdict."""


def calibrations() -> dict[str, float]:
    """Wall times of a calibration, cold and then warm, and over that of its fit [s]."""
    figures: dict[str, float] = {}
    with measured_project() as folder:
        for start in ("cold", "warm"):
            command = ["calibrate", "project.toml", "--quiet", "-o", start]
            figures[f"job_{start}_s"] = seconds = _run(command, folder)
            written = (folder / start / "result.json").read_text(encoding="utf-8")
            fit = fit_seconds(json.loads(written))
            figures[f"job_{start}_over_fit"] = seconds / fit
    return figures


def fit_seconds(result: dict[str, Any]) -> float:
    """Time up to the last step of a fit [s], from what `result.json` holds."""
    return result["history"][-1]["seconds"]


def swept() -> tuple[float, int]:
    """Wall time of a sweep with nothing compiled [s], and the trials that converged."""
    with measured_project() as folder:
        seconds = _run(["sweep", "sweep.toml", "--quiet"], folder)
        return seconds, len(read_sweep(folder / "sweep").of_state("converged"))


@contextmanager
def measured_project() -> Iterator[Path]:
    """Write the project with its candidates as poses, and a reading of each."""
    with tempfile.TemporaryDirectory() as home:
        folder, noise = Path(home), np.random.default_rng(0)
        text = PROJECT.read_text(encoding="utf-8")
        text = text.replace("[[candidates]]", "[[configurations]]")
        path = folder / "project.toml"
        path.write_text(text, encoding="utf-8")
        simulated, _ = load_project(path).simulate(TRUTH)
        head, *poses = re.split(r"(?m)^(?=\[\[configurations]])", text)
        for i, pose in enumerate(simulated.configurations):
            ((marker, at),) = ((p.name, p.simulated) for p in pose.points)
            x, y, z = 1e3 * (np.asarray(at) + STD * noise.standard_normal(3))
            rows = f"marker,x_mm,y_mm,z_mm\n{marker},{x:.4f},{y:.4f},{z:.4f}\n"
            (folder / f"pose_{i}.csv").write_text(rows, encoding="utf-8")
            poses[i] = re.sub(
                '(?m)^(name = ".*?".*)$',
                rf'\1\nmeasured = {{ file = "pose_{i}.csv" }}',
                poses[i],
            )
        path.write_text(head + "".join(poses), encoding="utf-8")
        (folder / "sweep.toml").write_text(SWEEP, encoding="utf-8")
        yield folder


def _run(command: Sequence[str], folder: Path) -> float:
    """Wall time of a command in a folder, which keeps what it compiles [s].

    Raises:
        RuntimeError: If it does not end with one of the codes of `ENDED`.
    """
    begin = time.perf_counter()
    done = subprocess.run(
        [*SOFTCAL, *command],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, **at_home(str(folder))},
    )
    if done.returncode not in ENDED:
        raise RuntimeError(f"softcal {' '.join(command)}:\n{done.stderr.strip()}")
    return time.perf_counter() - begin
