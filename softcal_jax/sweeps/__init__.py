"""Run many calibrations, or calls of any function, side by side; keep rows in SQLite.

`softcal sweep` takes a sweep file, `run_sweep` any function.
"""

from softcal_jax.sweeps._calibration import CalibrationTrial as CalibrationTrial
from softcal_jax.sweeps._database import read_sweep as read_sweep
from softcal_jax.sweeps._file import Sweep as Sweep, load_sweep as load_sweep
from softcal_jax.sweeps._result import Group as Group, SweepResult as SweepResult
from softcal_jax.sweeps._row import (
    Outcome as Outcome,
    Progress as Progress,
    TrialRow as TrialRow,
)
from softcal_jax.sweeps._run import run_part as run_part, run_sweep as run_sweep
from softcal_jax.sweeps._tables import (
    best_trials as best_trials,
    doubts as doubts,
    figures_of_the_robot as figures_of_the_robot,
    notes_of_trials as notes_of_trials,
    plot_sweep as plot_sweep,
    readable_figure as readable_figure,
    spread_table as spread_table,
    sweep_table as sweep_table,
    swept as swept,
    tabulated as tabulated,
    varied_table as varied_table,
    write_sweep_csv as write_sweep_csv,
)
from softcal_jax.sweeps._trial import (
    Points as Points,
    Range as Range,
    Trial as Trial,
    grid as grid,
    sample as sample,
)
