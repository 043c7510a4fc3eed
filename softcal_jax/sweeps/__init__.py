"""Run many calibrations, or calls of any function, side by side; keep rows in SQLite.

`softcal sweep` takes a sweep file, `run_sweep` any function.
"""

from softcal_jax.sweeps._calibration import CalibrationTrial
from softcal_jax.sweeps._database import read_sweep
from softcal_jax.sweeps._file import Sweep, load_sweep
from softcal_jax.sweeps._progress import Progress
from softcal_jax.sweeps._result import Group, SweepResult
from softcal_jax.sweeps._row import Outcome, TrialRow
from softcal_jax.sweeps._run import run_sweep
from softcal_jax.sweeps._summary import SweepSummary, SweptAxis, summarise
from softcal_jax.sweeps._tables import plot_sweep, sweep_table, write_sweep_csv
from softcal_jax.sweeps._trial import Range, Trial, grid, sample

__all__ = [
    "CalibrationTrial",
    "Group",
    "Outcome",
    "Progress",
    "Range",
    "Sweep",
    "SweepResult",
    "SweepSummary",
    "SweptAxis",
    "Trial",
    "TrialRow",
    "grid",
    "load_sweep",
    "plot_sweep",
    "read_sweep",
    "run_sweep",
    "sample",
    "summarise",
    "sweep_table",
    "write_sweep_csv",
]
