"""Arguments of `softcal sweep` and of `softcal sweep show`."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from softcal_jax.cli._sweep import show_sweep, sweep

_SWEEP = """\
A sweep file names a project file and the axes of the sweep:

  project = "project.toml"

  [axes]
  layout = ["ends", "three"]        # of control points, from [layouts.NAME]
  configurations = { choose = 2 }   # fitted; the others are predicted
  start = { count = 10 }            # random starts; 0 is that of the project
  noise = { count = 20 }            # draws added to what is fitted; 0 adds none
  "material.nu" = [0.3, 0.4]        # any key of the project file

Each trial is a row of an SQLite file as soon as it has ended. A sweep that was stopped
or killed goes on when the same command is given again.

exit codes: 0 all trials converged, 1 some failed or did not converge, 2 bad input
"""

_SHOW = """\
examples:
  softcal sweep show sweep.sqlite                     means over starts and noise
  softcal sweep show sweep.sqlite --all               every trial
  softcal sweep show sweep.sqlite --by layout --plot layouts.png
  softcal sweep show sweep.sqlite --figure steps --figure "fit rms [m]"
"""


def sweep_words(words: Sequence[str]) -> list[str]:
    """Join the words "sweep show" of a command line to one."""
    if list(words[:2]) == ["sweep", "show"]:
        return ["sweep show", *words[2:]]
    return list(words)


def add_sweep(commands: "argparse._SubParsersAction", raw: Callable) -> None:
    """Add both commands to the parser."""
    run = commands.add_parser(
        "sweep",
        help="many calibrations, side by side, that can be stopped and resumed",
        description="Calibrates a project over and over: other layouts of control "
        "points, starts, draws of noise, sets of configurations, or values of any key.",
        epilog=_SWEEP,
        formatter_class=raw,
    )
    run.add_argument("sweep", metavar="SWEEP.toml", type=Path, help="the sweep file")
    run.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        type=Path,
        help="database for the rows (default: SWEEP.sqlite, beside the sweep file)",
    )
    run.add_argument(
        "--workers", metavar="N", type=int, help="worker processes (default: all cores)"
    )
    run.add_argument(
        "--cores-per-worker",
        metavar="N",
        type=int,
        default=1,
        help="threads of each (default: 1, which is fastest unless memory is short)",
    )
    run.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help='run on a Dask cluster, like "tcp://10.0.0.1:8786"',
    )
    run.add_argument(
        "--retry-failed", action="store_true", help="try again what failed before"
    )
    run.set_defaults(run=sweep)

    table = commands.add_parser(
        "sweep show",
        help="what a sweep has found, also while it runs",
        description="Tabulates the rows of a sweep, and draws them if asked to.",
        epilog=_SHOW,
        formatter_class=raw,
    )
    table.add_argument(
        "database", metavar="SWEEP.sqlite", type=Path, help="the database of the sweep"
    )
    table.add_argument(
        "--by",
        metavar="AXIS",
        action="append",
        help="group trials by this axis (several times for several)",
    )
    table.add_argument(
        "--figure",
        metavar="NAME",
        action="append",
        help="show this figure (several times for several)",
    )
    table.add_argument("--all", action="store_true", help="one line per trial")
    table.add_argument("--plot", metavar="FILE.png", type=Path, help="draw a picture")
    table.add_argument(
        "--csv", metavar="FILE.csv", type=Path, help="write one line per trial, in SI"
    )
    table.set_defaults(run=show_sweep)
