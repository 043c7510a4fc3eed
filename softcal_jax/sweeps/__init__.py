"""Run many calibrations, or calls of any function, side by side; keep rows in SQLite.

`softcal sweep` takes a sweep file, `run_sweep` any function.
"""

from softcal_jax.sweeps._database import read_sweep as read_sweep
from softcal_jax.sweeps._file import Sweep as Sweep, load_sweep as load_sweep
from softcal_jax.sweeps._result import (
    SweepResult as SweepResult,
    default_figures as default_figures,
    figure_name as figure_name,
    figure_values as figure_values,
    figures_of_the_robot as figures_of_the_robot,
    plot_sweep as plot_sweep,
    write_sweep_csv as write_sweep_csv,
)
from softcal_jax.sweeps._row import (
    FIT as FIT,
    HELD_OUT as HELD_OUT,
    OUT_OF_RANGE as OUT_OF_RANGE,
    CalibrationTrial as CalibrationTrial,
    Outcome as Outcome,
    Progress as Progress,
    State as State,
    TrialRow as TrialRow,
)
from softcal_jax.sweeps._run import run_part as run_part, run_sweep as run_sweep
from softcal_jax.sweeps._trial import (
    Points as Points,
    Range as Range,
    Trial as Trial,
    describe as describe,
    grid as grid,
    sample as sample,
    shown as shown,
)
