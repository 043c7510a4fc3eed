"""`softcal sweep`: many calibrations, side by side; `softcal sweep show`."""

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from softcal_jax.cli import _shared as cli
from softcal_jax.exchange.exporters import quantity

if TYPE_CHECKING:
    from softcal_jax.sweeps import Progress

MOST_SHOWN = 4  # figures of a trial in its line; its row holds all
_OPTIONS = "workers", "cores_per_worker", "retry_failed"
_OF_ROW = "state", "reason", "notes", "seconds", "compile_seconds", "worker", "ended"
_SWEEP = """\
A sweep file names a project file and the axes of the sweep:

  project = "project.toml"

  [axes]
  layout = ["ends", "three"]        # of control points, from [layouts.NAME]
  configurations = { choose = 2 }   # fitted; the others are predicted
  start = { count = 10 }            # random starts; 0 is that of the project
  noise = { count = 20 }            # draws added to what is fitted; 0 adds none
  "material.nu" = [0.3, 0.4]        # any key of the project file

Each trial becomes a row of a Parquet file, in the folder sweep, as soon as it ends. To
resume a sweep that was stopped or killed, run the same command again. Its page is
written beside the folder: sweep_report.html for sweep. More than 100 000 trials run in
parts, as jobs of a cluster: all write into one folder, --part 17 --of 1000 a file of
its own.

exit codes: 0 all trials converged, 1 some failed or did not converge, 2 bad input,
130 interrupted: the rows so far are kept
"""

_SHOW = """\
examples:
  softcal sweep show sweep                     means over starts and noise
  softcal sweep show sweep --all               every trial
  softcal sweep show sweep --by layout --plot layouts.pdf
  softcal sweep show sweep --figure steps --figure "fit rms [m]"
"""


def sweep(args: argparse.Namespace, show: cli.Display) -> None:
    import jax

    from softcal_jax.results import (
        check_sweep_page,
        console,
        sections,
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
        folder = args.output or loaded.folder
        options = {key: vars(args)[key] for key in _OPTIONS}
        options["executor"] = args.scheduler
        if args.part is None:
            check_sweep_page(folder)
        else:
            options["part"] = (args.part, args.of)
    show.lap("reading")
    options["progress"] = _progress_lines(show, tuple(loaded.points[0]))
    try:
        with cli.bad_input(RuntimeError):
            result = loaded.run(folder, **options)
    except KeyboardInterrupt:
        text = f"interrupted: the same command resumes from {folder}."
        if args.part is None:
            with suppress(OSError, ValueError):  # as on a full disk, or without a row
                result = read_sweep(folder)
                page = write_sweep(result, folder, sweep=loaded, timing_s=show.laps)
                ended = f"{len(result.rows)} of {len(loaded.points)} trials"
                text += f" {ended} are in {page}."
        raise cli.Stop(cli.INTERRUPTED, text) from None
    show.lap("trials")
    show.line()
    with cli.bad_input():  # a page that cannot be written
        show.line(console(sections(result)))
        show.line(f"Rows in {folder}; `softcal sweep show {folder}` shows more.")
        if args.part is None:
            page = write_sweep(result, folder, sweep=loaded, timing_s=show.laps)
            show.line(f"Report: open {page} in a browser.")
    show.times()
    bad = len(result.rows) - len(result.of_state("converged"))
    if bad:
        text = f"{bad} of {len(result.rows)} trials failed or did not converge."
        raise cli.Stop(cli.NOT_CONVERGED, text)


def _progress_lines(
    show: cli.Display, axes: Sequence[str]
) -> "Callable[[Progress], None]":
    """Return a callback that prints each trial as it ends, and says how many have."""

    def progress(now: "Progress") -> None:
        what = str(now)
        if now.row is None:
            done = f", {now.before} of them already done" if now.before else ""
            show.note(f"{now.total} trials{done}")
            what += ", the first trial compiles"
        else:
            row = _row_dict(now.row, axes)
            show.document(row, indent=None)
            show.note(_row_line(row))
        if now.ended < now.total:
            show.now(what, log=False, count=(now.ended, now.total))

    return progress


def _row_dict(row: Mapping[str, Any], axes: Sequence[str]) -> dict[str, Any]:
    """Return a row with its point and its figures apart."""
    point = json.loads(row["point"])
    others = {*axes, *_OF_ROW, "traceback", "point"}
    return {
        "point": {axis: point[axis] for axis in axes},
        "figures": {name: v for name, v in row.items() if name not in others},
        **{name: row[name] for name in _OF_ROW},
    }


def _row_line(row: Mapping[str, Any]) -> str:
    """Write how a trial ended: its point, then its figures or why it failed."""
    point = ", ".join(f"{axis} = {value}" for axis, value in row["point"].items())
    if row["state"] == "failed":
        return f"failed: {point}: {row['reason'].splitlines()[0]}"
    figures = [
        f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in row["figures"].items()
        if value is not None
    ]
    shown = ", ".join(figures[:MOST_SHOWN])
    return f"{row['state']}: {point}: {shown} ({row['seconds']:.1f} s)"


def show_sweep(args: argparse.Namespace, show: cli.Display) -> None:
    """Tabulate a sweep, even while it runs, and plot it on request."""
    from softcal_jax.plotting import PictureStyle
    from softcal_jax.results import console, sections
    from softcal_jax.sweeps import plot_sweep, read_sweep, write_sweep_csv

    cli.check_new(*filter(None, (args.csv, args.plot)), force=True)
    with cli.bad_input():
        result = read_sweep(args.folder)
        chosen = {"by": args.by, "figures": args.figure}
        rows = [_row_dict(row, result.axes) for row in result.rows]
        show.document({"name": result.name, "rows": rows})
        tree = sections(result, **chosen, every=args.all)
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
    where = "folder for the rows (default: SWEEP, beside the sweep file)"
    cli.add_path(run, "--output", "DIR", where)
    text = "run this one of --of N parts, from 0, for more than 100 000 trials, as "
    text += "jobs of a cluster that share the folder"
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
    cli.add_path(table, "folder", "SWEEP", "the folder of the sweep")
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
