"""Run many calibrations, or calls of any function, side by side; keep rows in Parquet.

`softcal sweep` takes a sweep file, `run_sweep` any function.
"""

from softcal_jax.sweeps._file import Sweep as Sweep, load_sweep as load_sweep
from softcal_jax.sweeps._folder import read_sweep as read_sweep
from softcal_jax.sweeps._result import (
    SweepResult as SweepResult,
    figure_name as figure_name,
    plot_sweep as plot_sweep,
    write_sweep_csv as write_sweep_csv,
)
from softcal_jax.sweeps._row import Outcome as Outcome, Progress as Progress
from softcal_jax.sweeps._run import run_sweep as run_sweep
from softcal_jax.sweeps._trial import (
    Range as Range,
    Trial as Trial,
    grid as grid,
    sample as sample,
)
