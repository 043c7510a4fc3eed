"""Functions of sweeps that take no time, for worker processes to import.

Run as a program it is a sweep that a test can kill: `python cheap.py FOLDER WHERE`,
with a number of workers or the address of a scheduler.
"""

import os
import sys
import time
from pathlib import Path

import numpy as np

from softcal_jax.sweeps import Outcome, grid, run_sweep

POINTS = grid({"E": [2e5, 3e5], "kind": ["u", "v"], "draw": range(6)})


def measure(trial):
    """Some figures of the trial's own random numbers; one fails, one is not good."""
    random = np.random.default_rng(trial.seed)
    value = trial["E"] * (1.0 + 0.1 * random.standard_normal())
    if trial["kind"] == "v" and trial["draw"] == 3:
        raise ArithmeticError(f"no value at E = {trial['E']:g}")
    good = trial["draw"] != 4
    return Outcome({"E found [Pa]": value, "draws": 1}, good, "" if good else "draw 4")


def slowly(trial):
    """The same, after a while: the test kills somebody meanwhile."""
    time.sleep(0.4)
    return measure(trial)


def together(trial):
    """The same, once two processes have begun; they meet in a folder."""
    place = Path(os.environ["SWEEP_MEETING"])
    (place / str(os.getpid())).touch()
    end = time.monotonic() + 120.0
    while len(list(place.iterdir())) < 2 and time.monotonic() < end:
        time.sleep(0.02)
    return measure(trial)


def asleep(trial):
    """Takes longer than any test waits, after it has told who it is."""
    Path(trial["file"]).write_text(str(os.getpid()))
    time.sleep(600.0)
    return {"x": 1}


def deadly(trial):
    """Dies of itself in one of the trials."""
    if trial["draw"] == 2:
        os.kill(os.getpid(), 9)
    return measure(trial)


def where(trial):
    """Tells what a worker computes with."""
    import jax

    from softcal_jax.equilibrium import usable_cores

    return {
        "float64": int(jax.config.read("jax_enable_x64")),
        "cores": usable_cores(),
        "process": os.getpid(),
    }


def compiled(trial):
    """Where, and the sum of squares, by a program of its own for each length."""
    squares = _squares(np.arange(float(trial["length"])))
    return {"sum": float(squares)} | where(trial)


def _squares(values):
    import jax

    return jax.jit(_SQUARES)(values)


def _SQUARES(values):
    return (values**2).sum()


if __name__ == "__main__":
    here = sys.argv[2].isdigit()
    run_sweep(
        slowly,
        POINTS,
        Path(sys.argv[1]),
        repeats=["draw"],
        workers=int(sys.argv[2]) if here else None,
        executor=None if here else sys.argv[2],
    )
