"""`softcal sweep`: many calibrations, side by side; `softcal sweep show`."""

import argparse
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from softcal_jax.cli import _shared as cli
from softcal_jax.exchange.exporters import quantity

if TYPE_CHECKING:
    from softcal_jax.sweeps import Progress, Sweep, TrialRow

MOST_SHOWN = 4  # figures of a trial in its line; its row holds all
_OPTIONS = "workers", "cores_per_worker", "scheduler"  # say where trials run
_SWEEP = """\
A sweep file names a project file and the axes of the sweep:

  project = "project.toml"

  [axes]
  layout = ["ends", "three"]        # of control points, from [layouts.NAME]
  configurations = { choose = 2 }   # fitted; the others are predicted
  start = { count = 10 }            # random starts; 0 is that of the project
  noise = { count = 20 }            # draws added to what is fitted; 0 adds none
  "material.nu" = [0.3, 0.4]        # any key of the project file

Each trial becomes a row of an SQLite file as soon as it ends. To resume a sweep that
was stopped or killed, run the same command again. Its page is written beside the
database: sweep_report.html for sweep.sqlite. More than 100 000 trials run in parts, as
jobs of a cluster: --part 17 --of 1000 writes one Parquet file into a folder.

exit codes: 0 all trials converged, 1 some failed or did not converge, 2 bad input,
130 interrupted: the rows so far are kept
"""

_SHOW = """\
examples:
  softcal sweep show sweep.sqlite                     means over starts and noise
  softcal sweep show sweep.sqlite --all               every trial
  softcal sweep show sweep.sqlite --by layout --plot layouts.pdf
  softcal sweep show sweep.sqlite --figure steps --figure "fit rms [m]"
"""


def sweep(args: argparse.Namespace, show: cli.Display) -> None:
    import jax

    from softcal_jax.report import (
        check_sweep_page,
        console,
        sweep_sections,
        write_sweep,
    )
    from softcal_jax.sweeps import load_sweep, read_sweep

    # Only a program may set this, for itself and its workers; a library must not.
    jax.config.update("jax_enable_x64", True)
    show.lap("import")
    show.now(f"reading {args.sweep.name}")
    with cli.bad_input():
        loaded = load_sweep(args.sweep)
        if (args.part is None) != (args.of is None):
            raise ValueError("--part and --of go together: --part 17 --of 1000.")
        database = args.output or loaded.database
        if args.part is not None and args.retry_failed:
            raise ValueError(
                "--retry-failed is for a database: remove the file of a part, and it "
                "is run again."
            )
        if args.part is None:
            check_sweep_page(database)
    show.lap("reading")
    options = {key: vars(args)[key] for key in _OPTIONS}
    options["progress"] = _progress_lines(show)
    if args.part is not None:
        _part(args, show, loaded, options)
        return
    try:
        with cli.bad_input(RuntimeError):
            result = loaded.run(database, retry_failed=args.retry_failed, **options)
    except KeyboardInterrupt:
        text = f"interrupted: the same command resumes from {database}."
        with suppress(OSError, ValueError):  # as on a full disk, or without a database
            result = read_sweep(database)
            page = write_sweep(result, database, sweep=loaded, timing_s=show.laps)
            text += f" {len(result.rows)} of {len(loaded.points)} trials are in {page}."
        raise cli.Stop(cli.INTERRUPTED, text) from None
    show.lap("trials")
    show.line()
    with cli.bad_input():  # rows that were edited
        show.line(console(sweep_sections(result)))
        show.line(f"Rows in {database}; `softcal sweep show {database}` shows more.")
        page = write_sweep(result, database, sweep=loaded, timing_s=show.laps)
    show.line(f"Report: open {page} in a browser.")
    show.times()
    bad = len(result.rows) - len(result.of_state("converged"))
    if bad:
        text = f"{bad} of {len(result.rows)} trials failed or did not converge."
        raise cli.Stop(cli.NOT_CONVERGED, text)


def _part(
    args: argparse.Namespace,
    show: cli.Display,
    loaded: "Sweep",
    options: dict[str, Any],
) -> None:
    """Run one part of a large sweep, without a page."""
    folder = args.output or loaded.path.with_suffix("")
    try:
        with cli.bad_input(RuntimeError):
            path = loaded.run_part(folder, part=args.part, of=args.of, **options)
    except KeyboardInterrupt:
        text = "interrupted: this part was not written; run it again from the start."
        raise cli.Stop(cli.INTERRUPTED, text) from None
    from pyarrow.parquet import read_table

    show.lap("trials")
    show.line(f"Rows in {path}.")
    show.times()
    states = read_table(path, columns=["state"])["state"].to_pylist()
    bad = sum(state != "converged" for state in states)
    if bad:
        text = f"{bad} of {len(states)} trials failed or did not converge; remove "
        raise cli.Stop(cli.NOT_CONVERGED, f"{text}{path.name} to run this part again.")


def _progress_lines(show: cli.Display) -> "Callable[[Progress], None]":
    """Return a callback that prints each trial as it ends, and says how many have."""

    def progress(now: "Progress") -> None:
        what = str(now)
        if now.row is None:
            done = f", {now.before} of them already done" if now.before else ""
            show.note(f"{now.total} trials{done}")
            what += ", the first trial compiles"
        else:
            show.document(_row_dict(now.row), indent=None)
            show.note(_row_line(now.row))
        if now.ended < now.total:
            show.now(what, log=False, count=(now.ended, now.total))

    return progress


def _row_dict(row: "TrialRow") -> dict[str, Any]:
    return {key: v for key, v in vars(row).items() if key not in ("key", "traceback")}


def _row_line(row: "TrialRow") -> str:
    """Write how a trial ended: its point, then its figures or why it failed."""
    point = ", ".join(f"{axis} = {value}" for axis, value in row.point.items())
    if row.state == "failed":
        return f"failed: {point}: {row.reason.splitlines()[0]}"
    figures = [
        f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in row.figures.items()
        if value is not None
    ]
    shown = ", ".join(figures[:MOST_SHOWN])
    return f"{row.state}: {point}: {shown} ({row.seconds:.1f} s)"


def show_sweep(args: argparse.Namespace, show: cli.Display) -> None:
    """Tabulate a sweep, even while it runs, and plot it on request."""
    from softcal_jax.plotting import PictureStyle
    from softcal_jax.report import console, sweep_sections
    from softcal_jax.sweeps import plot_sweep, read_sweep, write_sweep_csv

    cli.check_new(*filter(None, (args.csv, args.plot)), force=True)
    with cli.bad_input():
        result = read_sweep(args.database)
        chosen = {"by": args.by, "figures": args.figure}
        show.document({"name": result.name, "rows": [*map(_row_dict, result.rows)]})
        tree = sweep_sections(result, **chosen, every=args.all)
        show.line(console(tree))
        if args.csv is not None:
            write_sweep_csv(result, args.csv)
            show.line(f"One line per trial in {args.csv}.")
        if args.plot is not None:
            width = 1e3 * quantity("--width", args.width, "m")
            style = PictureStyle(width, args.font_size)
            left_out = plot_sweep(result, args.plot, **chosen, style=style)
            more = f"; without {left_out} trials that failed or did not converge"
            show.line(f"Picture in {args.plot}{more if left_out else ''}.")


def add_sweep(commands: "argparse._SubParsersAction") -> None:
    run = commands.add_parser(
        "sweep",
        help="many calibrations, side by side, that can be stopped and resumed",
        description="Calibrates a project over and over: other layouts of control "
        "points, starts, draws of noise, sets of configurations, or values of any key.",
        epilog=_SWEEP,
    )
    cli.add_path(run, "sweep", "SWEEP.toml", "the sweep file")
    where = "database for the rows (default: SWEEP.sqlite, beside the sweep file), or "
    where += "with --part the folder for the parts (default: SWEEP)"
    cli.add_path(run, "--output", "FILE", where)
    text = "run this one of --of N parts, from 0, and write a Parquet file: more than "
    text += "100 000 trials, as jobs of a cluster"
    run.add_argument("--part", metavar="K", type=int, help=text)
    number = {"metavar": "N", "type": int}
    run.add_argument("--of", **number, help="number of parts")
    workers = "worker processes (default: all cores)"
    run.add_argument("--workers", **number, help=workers)
    threads = "threads of each (default: 1, which is fastest unless memory is short)"
    run.add_argument("--cores-per-worker", **number, default=1, help=threads)
    cluster = 'run on a Dask cluster, like "tcp://10.0.0.1:8786"'
    run.add_argument("--scheduler", metavar="ADDRESS", help=cluster)
    again = "retry the trials that failed"
    run.add_argument("--retry-failed", action="store_true", help=again)
    cli.add_output(run)
    run.set_defaults(run=sweep)

    table = commands.add_parser(
        "sweep show",
        help="the results of a sweep, even while it runs",
        description="Tabulates the rows of a sweep, and draws them if asked to.",
        epilog=_SHOW,
    )
    cli.add_path(table, "database", "SWEEP.sqlite", "the database of the sweep")
    for flag, metavar, what in (
        ("--by", "AXIS", "group trials by this axis (repeat for several)"),
        ("--figure", "NAME", "show this figure (repeat for several)"),
    ):
        table.add_argument(flag, metavar=metavar, action="append", help=what)
    table.add_argument("--all", action="store_true", help="one line per trial")
    cli.add_path(table, "--plot", "FILE", "draw a picture: .pdf, .svg or .png")
    width = 'width of the picture (default: "88 mm", a column of a journal)'
    table.add_argument("--width", metavar="LENGTH", default="88 mm", help=width)
    words = "size of its words, in points (default: 8)"
    table.add_argument("--font-size", metavar="N", type=float, default=8.0, help=words)
    cli.add_path(table, "--csv", "FILE.csv", "write one line per trial, in SI units")
    cli.add_output(table)
    table.set_defaults(run=show_sweep)
